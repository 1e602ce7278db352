"""Damaged text files of every format: nothing but an InputError, in one line."""

from __future__ import annotations

import gzip
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from raden_torch.capture.exchange import load_measurement
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
NATIVE = """# material: a card
# quantity: XYZ reflectance factor, perfect reflecting diffuser Y = 100 in every geometry; D65
# scale_std: 0.002
# zero_std_deg: 0.1 0.1 0.1
# readings: 3
incidence_deg,receiving_deg,tilt_deg,X,Y,Z,std_X,std_Y,std_Z,count,valid
0,-70,-10,19.5,20.1,19.1,0.1,0.1,0.1,3,1
0,-70,-65,18.5,,18.3,0.1,0.1,0.1,3,1
5,10,0,7,8,9,0.1,0.1,0.1,3,0
"""
LIGHTTOOLS_BSDF = """# Sample: a card
Symmetry Asymmetric
SpectralContent Monochrome
ScatterAzimuth 2
0 90
ScatterRadial 2
0 10
DataBegin
AOI 30
POI 0
Side Front
Wavelength 550
ScatterType BRDF
TIS 0.5
0.4 0.3
0.4 0.2
DataEnd
"""
SPEOS_BSDF = """OPTIS - Anisotropic BSDF surface file v8.0
0
a comment
6
a card
0 1 0
1 0
1
1
0
1
30
30 0

1
550 20
2 2
\t0 180
10 0.1 0.2
20 0.1 0.2
End of file
"""
XML = """<?xml version="1.0" encoding="UTF-8"?>
<WindowElement xmlns="http://windows.lbl.gov"><Optical><Layer>
<DataDefinition><IncidentDataStructure>TensorTree3</IncidentDataStructure></DataDefinition>
<WavelengthData><Wavelength unit="Integral">Visible</Wavelength><WavelengthDataBlock>
<WavelengthDataDirection>Reflection Back</WavelengthDataDirection>
<AngleBasis>LBNL/Shirley-Chiu</AngleBasis>
<ScatteringData>{ {1}{2}{3}{4}{5}{6}{7}{ 1 2 3 4 5 6 7 8 } }</ScatteringData>
</WavelengthDataBlock></WavelengthData></Layer></Optical></WindowElement>
"""
WHOLE = {
    "native": NATIVE,
    "fred": FRED,
    "zemax": ZEMAX,
    "astm": ASTM,
    "lighttools": LIGHTTOOLS,
    "speos": SPEOS,
    "lighttools_bsdf": LIGHTTOOLS_BSDF,
    "speos_bsdf": SPEOS_BSDF,
    "xml": XML,
}
WORDS = b"1e308 -1e308 1e999 nan -inf 1e-320 0 -1 1000000000 1_0 0x10 1.2.3 . 1,5 1,234 #N/A"
NUMBERS = (*WORDS.split(), b"9" * 30, b"9" * 5000, b"", "²".encode())
ENCODINGS = ("utf-16", "utf-16-be", "utf-8-sig", "cp932", "cp1252", "utf-32")
MUTATIONS: dict[str, Callable[[bytes, Random], bytes]] = {}
PIECES = st.sampled_from(
    [b"", b"\n", b"\t", b" ", b",", b"-", b"1e999", b"1e308", b"nan", b"0", b"9" * 30, b"\xff"]
) | st.binary(max_size=4)


def mutation(change: Callable[[bytes, Random], bytes]) -> Callable[[bytes, Random], bytes]:
    MUTATIONS[change.__name__] = change
    return change


@mutation
def truncate(data: bytes, random: Random) -> bytes:
    return data[: random.randrange(len(data) + 1)]


@mutation
def flip(data: bytes, random: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(min(random.choice([1, 1, 3, 30]), len(data))):
        changed[random.randrange(len(data))] ^= 1 << random.randrange(8)
    return bytes(changed)


@mutation
def insert_bytes(data: bytes, random: Random) -> bytes:
    at = random.randrange(len(data) + 1)
    piece = random.choice(
        [b"\0", b"\xff", b'"', b"#", b"\r", b"\n", b"\t" * 1000, b"\x1f\x8b\x08", b"="]
    )
    return data[:at] + piece + data[at:]


@mutation
def move_lines(data: bytes, random: Random) -> bytes:
    """Delete, repeat, swap, or shuffle lines."""
    lines = data.split(b"\n")
    at, other = random.randrange(len(lines)), random.randrange(len(lines))
    kind = random.choice(["delete", "repeat", "swap", "many", "shuffle"])
    if kind == "delete":
        del lines[min(at, other) : max(at, other) if random.random() < 0.3 else min(at, other) + 1]
    elif kind == "repeat":
        lines.insert(other, lines[at])
    elif kind == "swap":
        lines[at], lines[other] = lines[other], lines[at]
    elif kind == "many":
        lines[at:at] = [lines[at]] * random.choice([10, 1000])
    else:
        random.shuffle(lines)
    return b"\n".join(lines)


@mutation
def change_numbers(data: bytes, random: Random) -> bytes:
    places = [match.span() for match in re.finditer(rb"[-+]?[0-9]+(\.[0-9]+)?", data)]
    for begin, end in sorted(random.sample(places, min(len(places), random.choice([1, 1, 2, 8]))))[
        ::-1
    ]:
        data = data[:begin] + random.choice(NUMBERS) + data[end:]
    return data


@mutation
def change_first_numbers(data: bytes, random: Random) -> bytes:
    """Those of the header: what counts and claims."""
    head = change_numbers(data[:600], random)
    return head + data[600:]


@mutation
def swap_separators(data: bytes, random: Random) -> bytes:
    old, new = random.sample([b",", b";", b"\t", b" ", b".", b"\n"], 2)
    return data.replace(old, new, random.choice([-1, -1, 1, 20]))


@mutation
def repeat_words(data: bytes, random: Random) -> bytes:
    at = random.randrange(len(data) + 1)
    return (
        data[:at]
        + data[at : at + random.choice([1, 5, 40])] * random.choice([2, 50, 5000])
        + data[at:]
    )


@mutation
def other_encoding(data: bytes, random: Random) -> bytes:
    return data.decode("latin-1").encode(random.choice(ENCODINGS), "ignore")


@mutation
def pack(data: bytes, random: Random) -> bytes:
    return gzip.compress(data * random.choice([1, 1, 1, 50]), 1)


def mutated(data: bytes, random: Random) -> bytes:
    """One to four mutations, one after the other."""
    for _ in range(random.choice([1, 1, 2, 2, 3, 4])):
        data = MUTATIONS[random.choice([*MUTATIONS])](data, random)
        if not data:
            break
    return data


def check_damaged(path: Path) -> bool:
    """Load what may be damaged: whether it was refused, in one line that names the file."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what damaged text was taken for
            load_measurement(path)
    except InputError as error:
        assert str(error).startswith(f"{path}: "), str(error)[:500]  # noqa: PT017
        assert "\n" not in str(error), str(error)[:500]  # noqa: PT017
        return True
    return False


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
    check_damaged(path)


@pytest.mark.parametrize("name", WHOLE)
def test_structured_damage_raises_nothing_but_input_errors(tmp_path: Path, name: str) -> None:
    """Lines, numbers, separators and encodings changed on purpose; most of it is refused."""
    path = tmp_path / "a.txt"
    refused = 0
    for seed in range(400):
        path.write_bytes(mutated(WHOLE[name].encode(), Random(seed)))
        refused += check_damaged(path)
    assert 100 < refused < 400
