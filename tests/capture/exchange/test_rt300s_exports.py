"""The RT-300S's exports for LightTools and SPEOS: one pair of real files of the same readings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.exchange import load_measurement
from raden_torch.errors import InputError

LIGHTTOOLS = """Name / Comment :\ta card\t
Date:\t1/2/2025\t
Data file type :\tIntensity BRDF\t
Theta sample :\t0\t
Theta measure beginning :\t-30\t
Theta measure end :\t30\t
Theta measure step :\t30\t
Phi measure beginning :\t-90\t
Phi measure end :\t-80\t
Phi measure step :\t10\t
Theta Lighting\t30
-30\t1\t2
0\t50\t40
30\t60\t-1
\t\t
"""
SPEOS = """OPTIS - Anisotropic BSDF surface file v1.0
SampleID:\tSample 30
0 1 0
1\t0
0
1
3
0 45 90
10 0
Reflection Spectrum
2
100 50
1000 50
\t-90\t-80
-30\t1\t2
0\t50\t40
30\t60\t-1

\t0\t180\t190
0\t0\t0\t0
30\t0\t0\t0
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "a.txt"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["test_lighttools.txt", "test_speos.rtd"])
def test_the_real_exports_are_read(goniometer: Path, name: str) -> None:
    """Rationale: two runs over incidence 0 and 60; the first left only zeros, the second was not
    calibrated, so every value is negative, and stays so.
    """
    m = load_measurement(goniometer / name)
    assert (len(m), int(m.valid.sum())) == (24, 10)
    assert set(np.round(m.values[m.valid, 0] < 0)) == {True}
    notes = " ".join(m.metadata.notes)
    assert "2 of 4 tables hold only zeros" in notes
    assert "12 of 24 values are negative" in notes
    assert "4 readings where the detector hides the lamp" in notes
    flat = m.valid & np.isclose(m.incidence_deg, 60) & np.isclose(m.receiving_deg, 30)
    np.testing.assert_allclose(m.values[flat], -49096.61 / np.cos(np.pi / 6))


def test_the_real_exports_agree(goniometer: Path) -> None:
    one = load_measurement(goniometer / "test_lighttools.txt")
    two = load_measurement(goniometer / "test_speos.rtd")
    for name in ("incidence_deg", "receiving_deg", "tilt_deg", "azimuth_deg", "values", "valid"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.parametrize("text", [LIGHTTOOLS, SPEOS])
@pytest.mark.parametrize("ends", ["\n", "\r", "\r\n"])
def test_angles_and_values_are_the_instruments(tmp_path: Path, text: str, ends: str) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(text.replace("\n", ends).encode())
    m = load_measurement(path)
    assert m.channels == ("650nm",)
    assert m.azimuth_deg is not None
    at = m.azimuth_deg == -90
    np.testing.assert_allclose(m.incidence_deg[at], 30)
    np.testing.assert_allclose(m.receiving_deg[at], [-30, 0, 30])
    assert m.valid[at].tolist() == [False, True, True]  # at −30 the detector hides the lamp
    np.testing.assert_allclose(
        m.values[at, 0], np.array([1, 50 * np.cos(np.pi / 6), 60]) / 0.75**0.5
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "Theta Lighting\t30\n",
            "Theta Lighting\tup\n",
            "line 11, column 2: expected a number, got 'up'",
        ),
        (
            "Theta Lighting\t30\n",
            "Theta Lighting\t120\n",
            "line 11: Theta Lighting: expected 0…90 degrees, got 120",
        ),
        ("0\t50\t40\n", "0\t50\n", "line 13: expected an angle and 2 values, got 2 numbers"),
        ("0\t50\t40\n", "0\t50\tx\n", "line 13, column 3: expected a number, got 'x'"),
        (
            "0\t50\t40\n",
            "5\t50\t40\n",
            "line 13, column 1: expected 0 degrees by the file's header, got 5",
        ),
        (
            "30\t60\t-1\n\t\t\n",
            "",
            r"expected 3 rows by its header, got 3 lines|line 14: .*, got 0 numbers",
        ),
        ("Phi measure step :\t10", "Phi measure step :\t0", "line 8: Phi: .*, got -90 to -80 by 0"),
        (
            "step :\t30",
            "step :\t1e-9",
            "line 5: Theta: expected a row of .*, got -30 to 30 by 1e-09",
        ),
        ("step :\t30", "step :\t1e-320", "line 5: Theta: expected a row of .*, got -30 to 30 by "),
        (
            "Theta measure step :\t30\t\n",
            "",
            "from line 1: expected 'Theta measure step :' before .*, got none",
        ),
        (
            "Intensity BRDF",
            "Intensity BTDF",
            "line 3: expected 'Intensity BRDF', got 'Intensity BTDF'",
        ),
        (
            "Theta Lighting\t30\n",
            "",
            "line 11: expected a 'key : value' line or 'Theta Lighting' with its rows, got ",
        ),
        (
            "-30\t1\t2\n0\t50\t40\n30\t60\t-1",
            "-30\t0\t0\n0\t0\t0\n30\t0\t0",
            "expected a measurement, got values that are all 0",
        ),
    ],
)
def test_bad_lighttools_input_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    check_refused(written(tmp_path, LIGHTTOOLS.replace(old, new)), message)


def test_a_lighttools_file_cut_in_its_header_is_refused(tmp_path: Path) -> None:
    check_refused(
        written(tmp_path, LIGHTTOOLS + LIGHTTOOLS[:40]),
        "block from line 16, got the end of the file: it is",
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("v1.0", "v2.0", "line 1: expected 'OPTIS - .* file v1.0', or v7.0 or v8.0, got "),
        ("Sample 30", "Sample A", "line 2, column 2: expected a number, got 'A'"),
        ("Sample 30", "Sample 95", "line 2: incidence: expected 0…90 degrees, got 95"),
        ("SampleID", "Id", "line 2: expected 'SampleID: Sample <incidence>', got "),
        ("1\t0\n0\n", "0\t1\n0\n", "line 4: .*reflection, no transmission"),
        ("1\t0\n0\n", "1\t0\n1\n", "line 5: expected 0 .*, got '1'"),
        (
            "Spectrum\n2\n",
            "Spectrum\n99999999999\n",
            "line 11: Reflection Spectrum: expected a whole number ",
        ),
        (
            "Spectrum\n2\n",
            "Spectrum\n9999\n",
            "expected a row of azimuths, got the end of the block",
        ),
        ("0\t50\t40\n", "0\t50\n", "line 16: expected an angle and 2 values, got 2 numbers"),
        ("0\t50\t40\n", "0\t50\tx\n", "line 16, column 3: expected a number, got 'x'"),
        ("\n0\t50\t40", "\n900\t50\t40", "angle: expected at most 360 degrees, got 900"),
        (
            "\n\n\t0\t180\t190\n0\t0\t0\t0\n30\t0\t0\t0\n",
            "\n\n",
            "expected a second table, got the end",
        ),
    ],
)
def test_bad_speos_input_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in SPEOS
    check_refused(written(tmp_path, SPEOS.replace(old, new)), message)


@pytest.mark.parametrize("lines", range(2, 18))
def test_a_speos_file_cut_after_any_line_is_refused(tmp_path: Path, lines: int) -> None:
    text = "\n".join(SPEOS.splitlines()[:lines])
    check_refused(written(tmp_path, text), "got the end of the block|got '")


def check_refused(path: Path, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load_measurement(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
