"""Zemax's tabular BSDF: the real file, the geometry about the mirror direction, bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from raden_torch.capture.exchange import load_measurement
from raden_torch.errors import InputError
from raden_torch.geometry import vectors_from_angles
from raden_torch.measurement import BrdfMeasurement

REAL = "ValidationTest_of_TIS_via_BrownVinyl.bsdf"
TEXT = """# Sample: a card
# Light source: laser (633 nm)
Source  Measured
Symmetry  PlaneSymmetrical
SpectralContent  Monochrome
ScatterType  BRDF
SampleRotation  1
0
AngleOfIncidence  1
30
ScatterAzimuth  3
0 90 180
ScatterRadial  3
0 10 70

Monochrome
DataBegin
TIS 0.5
0.4 0.3 0.1
0.4 0.2 0.1
0.4 0.1 0.1
DataEnd
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "a.bsdf"
    path.write_text(text, encoding="utf-8")
    return path


def about_the_mirror(m: BrdfMeasurement) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Polar angle of the light, radial and azimuth about the mirror direction, in degrees."""
    angles = (m.incidence_deg, m.receiving_deg, m.tilt_deg)
    maps = (torch.from_numpy(np.deg2rad(a)).reshape(1, 1, -1) for a in angles)
    n, light, v = (x.reshape(3, -1).numpy() for x in vectors_from_angles(*maps))
    mirror = 2 * (n * light).sum(0) * n - light
    to_normal = n - (mirror * n).sum(0) * mirror
    across = np.cross(mirror, to_normal, axis=0)
    across /= np.linalg.norm(across, axis=0)
    to_normal /= np.linalg.norm(to_normal, axis=0)
    radial = 2 * np.arcsin(np.linalg.norm(v - mirror, axis=0) / 2)
    azimuth = np.arctan2((v * across).sum(0), (v * to_normal).sum(0))
    polar = np.arctan2(np.linalg.norm(np.cross(n, light, axis=0), axis=0), (n * light).sum(0))
    return np.rad2deg(polar), np.rad2deg(radial), np.rad2deg(azimuth)


def test_the_real_file_is_read(goniometer: Path) -> None:
    m = load_measurement(goniometer / REAL)
    assert len(m) == 1214
    assert m.metadata.sample.startswith("Validation test of TIS")
    assert m.metadata.instrument == "Wyant College's J&C RT-300S"
    # 4 incidences x 19 azimuths x 12 radials and their mirror images, less what is no reading
    assert 4 * 19 * 12 + 748 - 129 - 245 - (76 - 4) == 1214
    for count, what in ((748, "added as mirror"), (129, "exactly 0"), (245, "horizon")):
        assert any(n.startswith(f"{count} ") and what in n for n in m.metadata.notes)
    grazing = np.isclose(m.receiving_deg, 80) & np.isclose(m.incidence_deg, 70) & (m.tilt_deg == 0)
    np.testing.assert_allclose(m.values[grazing], 100 * np.pi * 4.041)


@pytest.mark.parametrize(("incidence", "total"), [(15, 0.108220), (30, 0.108966)])
def test_the_real_file_adds_up_to_its_own_total(
    goniometer: Path, incidence: float, total: float
) -> None:
    """Rationale: the file states the integral of its values over radial and azimuth, by trapezia
    and without a cosine. Taken from the readings' own angles, it tests the directions.
    """
    m = load_measurement(goniometer / REAL)
    polar, radial, azimuth = about_the_mirror(m)
    radials = np.array([0, 5, 10, 15, 20, 30, 40, 50, 60, 70, 80, 90.0])
    table = np.zeros((19, len(radials)))  # what was left out is 0 in the file
    for i in np.flatnonzero(np.isclose(polar, incidence, atol=1e-4)):
        column = int(np.argmin(abs(radials - radial[i])))
        assert radials[column] == pytest.approx(radial[i], abs=1e-4)
        row = slice(None) if column == 0 else round(abs(azimuth[i]) / 10)
        table[row, column] = m.values[i, 0] / (100 * np.pi)
    mean = (table[1:, 1:] + table[1:, :-1] + table[:-1, 1:] + table[:-1, :-1]) / 4
    sine = np.sin(np.deg2rad(radials))
    width = np.deg2rad(np.diff(radials)) * (sine[1:] + sine[:-1]) / 2
    # the file subtracts about 1e-6 for the beam itself
    assert (mean * width).sum() * np.deg2rad(10) == pytest.approx(total, abs=3e-6)


def test_azimuth_0_leads_from_the_mirror_to_the_normal(tmp_path: Path) -> None:
    m = load_measurement(written(tmp_path, TEXT))
    flat = m.select(m.tilt_deg == 0)
    by_receiving = dict(zip(flat.receiving_deg, flat.values[:, 0] / (100 * np.pi), strict=True))
    assert by_receiving == pytest.approx({30: 0.4, 20: 0.3, -40: 0.1, 40: 0.1})
    assert m.channels == ("633nm",)
    _, radial, azimuth = about_the_mirror(m)
    aside = np.isclose(radial, 10) & np.isclose(abs(azimuth), 90)
    assert sorted(np.round(azimuth[aside])) == [-90, 90]  # the second one is the mirror image
    np.testing.assert_allclose(m.values[aside], 100 * np.pi * 0.2)


def test_tristimulus_sections_and_sample_rotations(tmp_path: Path) -> None:
    head, data = TEXT.split("Monochrome\nDataBegin")
    block = data.split("DataEnd")[0]
    head = head.replace("Monochrome", "XYZ").replace("PlaneSymmetrical", "Asymmetrical4D")
    head = head.replace("SampleRotation  1\n0\n", "SampleRotation  2\n0 45\n")
    text = head + "".join(f"Tristimulus{c}\nDataBegin{block + block}DataEnd\n" for c in "XYZ")
    m = load_measurement(written(tmp_path, text))
    assert m.channels == ("X", "Y", "Z")
    assert m.azimuth_deg is not None
    assert sorted(set(m.azimuth_deg)) == [0, 45]
    np.testing.assert_allclose(m.values[:, 0], m.values[:, 2])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("DataEnd\n", "", "expected 'DataEnd', got the end of the file"),
        ("0.4 0.1 0.1\nDataEnd\n", "", "expected a row of 3 values, got the end of the file"),
        ("ScatterAzimuth  3\n", "ScatterAzimuth  4\n", "line 12: expected 4 angles of .*, got 3"),
        (
            "ScatterAzimuth  3\n",
            "ScatterAzimuth  -3\n",
            "line 11: .*expected a whole number .*, got '-3'",
        ),
        (
            "ScatterAzimuth  3\n",
            "ScatterAzimuth  9999999999\n",
            "line 11: .*expected a whole number 1…10000, got '9999999999'",
        ),
        (
            "0 90 180",
            "0 90 1e3",
            "line 12, column 3: ScatterAzimuth: expected 0…360 degrees, got 1000",
        ),
        ("0.4 0.2 0.1", "0.4 low 0.1", "line 20, column 2: expected a number, got 'low'"),
        ("0.4 0.2 0.1", "0.4 inf 0.1", "line 20, column 2: expected a number, got 'inf'"),
        ("0.4 0.2 0.1", "0.4 0.2", "line 20: expected 3 values, got 2|at most"),
        ("BRDF", "BTDF", "line 6: ScatterType: expected BRDF, got 'BTDF'"),
        ("TIS 0.5", "0.5", "line 18: expected 'TIS <number>', got '0.5'"),
        (
            "SampleRotation  1\n",
            "",
            "line 7: expected 'SampleRotation <number of angles>', got '0'",
        ),
    ],
)
def test_bad_input_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TEXT
    path = written(tmp_path, TEXT.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        load_measurement(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_header_that_claims_too_much_takes_no_memory(tmp_path: Path) -> None:
    many = " ".join(["1"] * 10_000)
    text = TEXT.replace("ScatterAzimuth  3\n0 90 180", f"ScatterAzimuth  10000\n{many}")
    text = text.replace("ScatterRadial  3\n0 10 70", f"ScatterRadial  10000\n{many}")
    text = text.replace("AngleOfIncidence  1\n30", f"AngleOfIncidence  10000\n{many}")
    with pytest.raises(
        InputError, match="expected 1 x 10000 x 10000 x 10000 values by its header, got at most"
    ):
        load_measurement(written(tmp_path, text))
