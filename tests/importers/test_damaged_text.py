"""Damaged text files of every format: nothing but an InputError, in one line."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from raden_torch.capture.importers import load_measurement
from raden_torch.errors import InputError

FRED = """type bsdf_data
format angles=deg bsdf=log scale=1
30 0
30 0 -1
-30 0 -2
"""
ZEMAX = """# Sample: a card
Source Measured
Symmetry PlaneSymmetrical
SpectralContent Monochrome
ScatterType BRDF
SampleRotation 1
0
AngleOfIncidence 1
30
ScatterAzimuth 2
0 90
ScatterRadial 2
0 10
Monochrome
DataBegin
TIS 0.5
0.4 0.3
0.4 0.2
DataEnd
"""
ASTM = """LAB_NAME "A LAB"
NUM_POINTS 2
VARS theta_i,phi_i,theta_s,phi_s,X,Y,Z
30,0,30,180,1,1,1
30,90,40,270,2,2,2
"""
LIGHTTOOLS = """Name / Comment :\ta card
Data file type :\tIntensity BRDF
Theta measure beginning :\t-30
Theta measure end :\t30
Theta measure step :\t30
Phi measure beginning :\t-90
Phi measure end :\t-80
Phi measure step :\t10
Theta Lighting\t20
-30\t1\t2
0\t50\t40
30\t60\t-1
"""
SPEOS = """OPTIS - Anisotropic BSDF surface file v1.0
SampleID:\tSample 20
0 1 0
1\t0
0
Reflection Spectrum
1
100 50
\t-90\t-80
-30\t1\t2
30\t60\t-1

\t0\t180
0\t0\t0
"""
WHOLE = {"fred": FRED, "zemax": ZEMAX, "astm": ASTM, "lighttools": LIGHTTOOLS, "speos": SPEOS}
PIECES = st.sampled_from(
    [b"", b"\n", b"\t", b" ", b",", b"-", b"1e999", b"1e308", b"nan", b"0", b"9" * 30, b"\xff"]
) | st.binary(max_size=4)


@pytest.mark.parametrize("name", WHOLE)
def test_the_whole_file_is_read(tmp_path: Path, name: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text(WHOLE[name], encoding="utf-8")
    assert load_measurement(path).valid.any()


@pytest.mark.parametrize("name", WHOLE)
@settings(
    max_examples=300,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    cuts=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 12), PIECES), min_size=1, max_size=3)
)
def test_damage_raises_nothing_but_input_errors(
    tmp_path: Path, name: str, cuts: list[tuple[float, int, bytes]]
) -> None:
    data = WHOLE[name].encode()
    for where, length, piece in cuts:
        at = round(where * len(data))
        data = data[:at] + piece + data[at + length :]
    path = tmp_path / "a.txt"
    path.write_bytes(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what damaged text was taken for
            load_measurement(path)
    except InputError as error:
        assert str(error).startswith(f"{path}: ")  # noqa: PT017
        assert "\n" not in str(error)  # noqa: PT017
