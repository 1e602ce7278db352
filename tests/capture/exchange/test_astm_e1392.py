"""The text form of ASTM E1392 (no real file of it is among the shared ones)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.exchange import load_measurement
from raden_torch.errors import InputError

HEAD = """LAB_NAME "A LAB"
SYSTEM_NAME a goniometer
SAMPLE_NAME "blue paint"
NUM_POINTS 3
"""
VARS = "VARS theta_i,phi_i,theta_s,phi_s,"
DEGREES = HEAD + VARS + "550nm,450nm\n30,0,40,180,0.2,0.1\n30,0,40,0,0.1,-0.3\n30,0,0,0,0,1\n"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "a.astm"
    path.write_text(text, encoding="utf-8")
    return path


def test_degrees_bands_and_header(tmp_path: Path) -> None:
    m = load_measurement(written(tmp_path, DEGREES))
    np.testing.assert_allclose(m.incidence_deg, 30)
    np.testing.assert_allclose(m.receiving_deg, [40, -40, 0])
    assert m.channels == ("450nm", "550nm")
    np.testing.assert_allclose(m.values[0], [10 * np.pi, 20 * np.pi])
    assert m.values[1, 0] == pytest.approx(-30 * np.pi)
    assert (m.metadata.sample, m.metadata.instrument) == ("blue paint", "a goniometer")
    assert ("LAB_NAME", "A LAB") in m.metadata.other
    assert "angles taken as degrees" in m.metadata.notes
    assert "1 of 6 values are negative (noise) and kept" in m.metadata.notes


def test_radians_are_noticed(tmp_path: Path) -> None:
    rows = "0.5236,3.1416,0.5236,0,0.3,0.3,0.3\n0.5236,3.1416,0.7,1,0.3,0.3,0.3\n"
    m = load_measurement(written(tmp_path, "LAB_NAME x\n" + VARS + "R,G,B\n" + rows))
    assert m.channels == ("R", "G", "B")
    np.testing.assert_allclose(m.incidence_deg[0], 30, atol=1e-3)
    np.testing.assert_allclose(m.receiving_deg[0], 30, atol=1e-3)
    assert "angles taken as radians" in m.metadata.notes


def test_incident_azimuths_are_the_samples_rotation(tmp_path: Path) -> None:
    rows = "30,0,30,180,1,1,1\n30,90,30,270,2,2,2\n"
    m = load_measurement(written(tmp_path, "LAB_NAME x\n" + VARS + "X,Y,Z\n" + rows))
    assert m.azimuth_deg is not None
    assert m.azimuth_deg.tolist() == [0, 90]
    np.testing.assert_allclose(m.receiving_deg, 30)


@pytest.mark.parametrize(("extra", "band"), [("", "550nm"), ("WAVELENGTH 633 nm\n", "633nm")])
def test_one_column_is_a_band(tmp_path: Path, extra: str, band: str) -> None:
    text = "LAB_NAME x\n" + extra + VARS + "BRDF\n30,0,30,180,1\n"
    assert load_measurement(written(tmp_path, text)).channels == (band,)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("NUM_POINTS 3", "NUM_POINTS 4", "expected 4 readings \\(NUM_POINTS\\) below VARS, got 3"),
        (
            "NUM_POINTS 3",
            "NUM_POINTS 99999999999",
            "line 4: NUM_POINTS: expected a whole number .*, got '99999999999'",
        ),
        (
            "NUM_POINTS 3",
            "NUM_POINTS three",
            "line 4: NUM_POINTS: expected a whole number .*, got 'three'",
        ),
        ("30,0,0,0,0,1\n", "30,0,0,0\n", "line 8: expected 6 numbers, got 4"),
        ("30,0,0,0,0,1\n", "30,0,0,0,0,x\n", "line 8, column 450nm: expected a number, got 'x'"),
        (
            "30,0,0,0,0,1\n",
            "30,0,0,nan,0,1\n",
            "line 8, column phi_s: expected a number, got 'nan'",
        ),
        (
            "30,0,0,0,0,1\n",
            "30,0,999,0,0,1\n",
            "reading 3, column theta_s: expected at most 180 degrees, got 999",
        ),
        ("phi_s,", "", "line 5: VARS: .*, got no phi_s"),
        ("550nm,450nm", "550nm,550nm", "line 5: VARS: .*, got a name twice"),
        (
            "550nm,450nm",
            "a,b",
            "line 5: VARS: channels: expected X,Y,Z or R,G,B or bands .*, got a, b",
        ),
        ("VARS theta", "vars theta", "line 5: expected a KEYWORD and its value, or VARS, got "),
        (
            DEGREES[len(HEAD) :],
            "",
            "expected a line 'VARS theta_i,phi_i,theta_s,phi_s,<channels>', got none",
        ),
    ],
)
def test_bad_input_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in DEGREES
    path = written(tmp_path, DEGREES.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        load_measurement(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
