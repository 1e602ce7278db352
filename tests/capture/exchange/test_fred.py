"""FRED's tabulated BSDF: the real export, its forms, and what is refused."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.exchange import load_measurement
from raden_torch.errors import InputError

HEAD = "type bsdf_data\nformat angles=deg bsdf=value scale=1\n"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "a.txt"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_real_export_is_read(goniometer: Path) -> None:
    m = load_measurement(goniometer / "AnoBlackEC1onAlum_fullAz.txt")
    assert len(m) == 2175
    assert m.valid.all()
    assert m.azimuth_deg is None
    mirror = (m.incidence_deg == 30) & (m.receiving_deg == 30) & (m.tilt_deg == 0)
    assert mirror.sum() == 1
    assert 12.5 < m.values[mirror, 0].item() < 14.5


def test_the_real_export_agrees_with_its_workbook(goniometer: Path) -> None:
    """Rationale: its authors subtracted a blank, set the least RT to 0 and averaged the two
    azimuths that mirror each other; the blank is not among the files, so the difference is the
    blank: at most 0.0048 in RT, which reaches 1.37. (With the blank it is within the text's
    rounding of 5e-7.) That every direction finds its readings tests the geometry of both.
    """
    export = load_measurement(goniometer / "AnoBlackEC1onAlum_fullAz.txt")
    raw = load_measurement(goniometer / "ANOPLATE_AnoBlack_EC1_Alum6061_v1o0_20251115.xls")
    at = defaultdict(list)
    for a, r, t, value in zip(
        raw.incidence_deg, raw.receiving_deg, raw.tilt_deg, raw.values[:, 0], strict=True
    ):
        at[round(a, 5), round(r, 5), round(abs(t), 5)].append(value)
    keys = [
        (round(a, 5), round(r, 5), round(abs(t), 5))
        for a, r, t in zip(export.incidence_deg, export.receiving_deg, export.tilt_deg, strict=True)
    ]
    assert all(key in at for key in keys)
    there = np.array([np.mean(at[key]) for key in keys])
    cosine = np.cos(np.deg2rad(export.receiving_deg)) * np.cos(np.deg2rad(export.tilt_deg))
    difference = (export.values[:, 0] - there) * cosine / 100
    assert abs(difference).max() < 0.0048
    assert np.median(abs(difference)) < 0.0015


def test_the_section_names_the_specular_direction(tmp_path: Path) -> None:
    text = HEAD + "40\t0\n40\t0\t0.5\n-40\t0\t0.25\n0\t0\t0.1\n40,90,0.2\n"
    m = load_measurement(written(tmp_path, text))
    np.testing.assert_allclose(m.incidence_deg[:3], 40)
    np.testing.assert_allclose(m.receiving_deg[:3], [40, -40, 0])
    np.testing.assert_allclose(m.values[:, 0], 100 * np.pi * np.array([0.5, 0.25, 0.1, 0.2]))
    assert abs(m.tilt_deg[3]) > 20


def test_direction_cosines_logarithms_and_scale(tmp_path: Path) -> None:
    rows = "0 0.5\n0 0.5 -1\n0 -0.5 -2\n0.5 0 -2\n"
    text = "type bsdf_data\nformat angles=sin bsdf=log scale=2\n" + rows
    m = load_measurement(written(tmp_path, text))
    np.testing.assert_allclose(m.incidence_deg[:2], 30)
    np.testing.assert_allclose(m.receiving_deg[:2], [30, -30])
    np.testing.assert_allclose(m.values[:, 0], 200 * np.pi * np.array([0.1, 0.01, 0.01]))
    degrees = HEAD + "30 0\n30 90 0.02\n"
    same = load_measurement(written(tmp_path, degrees))
    assert m.tilt_deg[2] == pytest.approx(same.tilt_deg[0])


def test_several_specular_azimuths_are_the_samples_rotation(tmp_path: Path) -> None:
    m = load_measurement(written(tmp_path, HEAD + "30 0\n30 0 1\n30 90\n30 90 0.5\n"))
    assert m.azimuth_deg is not None
    assert m.azimuth_deg.tolist() == [0, 90]
    np.testing.assert_allclose(m.receiving_deg, 30)


def test_one_direction_twice_is_averaged_and_counted(tmp_path: Path) -> None:
    m = load_measurement(written(tmp_path, HEAD + "30 0\n0 0 0.1\n0 90 0.3\n10 0 0.2\n"))
    assert m.count is not None
    assert m.count.tolist() == [2, 1]
    np.testing.assert_allclose(m.values[:, 0], 100 * np.pi * 0.2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("type bsdf_data\n", r"line 2: expected 'format angles="),
        (
            "type bsdf_data\nformat angles=rad bsdf=value scale=1\n",
            r"line 2: expected 'format angles=",
        ),
        (
            "type bsdf_data\nformat angles=deg bsdf=value scale=x\n",
            r"line 2, column scale: expected a number, got 'x'",
        ),
        (HEAD, "expected readings below its header, got none: the file is truncated"),
        (HEAD + "30 0\n", "expected readings below its header, got none"),
        (HEAD + "30 0 1\n", "line 3: expected a specular direction .*, got a reading before any"),
        (HEAD + "30 0\n30 0 one\n", r"line 4, column 3: expected a number, got 'one'"),
        (HEAD + "30 0\n30 0 nan\n", r"line 4, column 3: expected a number, got 'nan'"),
        (HEAD + "30 0\n30 0 1 2\n", "line 4: expected 2 numbers .* or 3 .*, got 4"),
        (
            HEAD + "30 0\n3000 0 1\n",
            "line 4, column 1: polar angle: expected at most 360 degrees, got '3000'",
        ),
        (
            HEAD + "30 0\n120 0 1\n",
            "expected a reflection measurement, got 1 readings, in none of which",
        ),
        (
            HEAD + "30 0\n30 0 1e308\n",
            "reading 1: (650nm|550nm): expected a finite reflectance factor, got inf",
        ),
        (
            HEAD.replace("deg", "sin") + "0 2\n0 0 1\n",
            "line 3: expected direction cosines, .*, got 0, 2",
        ),
    ],
)
def test_bad_input_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=message) as caught:
        load_measurement(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_bytes_that_are_not_utf8_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(HEAD.encode() + b"30 0\r\n30 0 \xff\r\n")
    with pytest.raises(InputError, match=r"line 4: expected UTF-8, .*, got byte 0xff"):
        load_measurement(path)


def test_a_file_too_large_is_refused_unread(tmp_path: Path) -> None:
    path = written(tmp_path, HEAD + "\n" * 70_000)
    with path.open("ab") as file:
        file.truncate(100_000_001)
    with pytest.raises(InputError, match="expected at most 100 MB, got "):
        load_measurement(path)
