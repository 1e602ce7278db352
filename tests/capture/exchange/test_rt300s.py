"""The RT-300S workbook: what the real files hold, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from raden_torch.capture.exchange import load_measurement, rt300s
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement

EC1 = "ANOPLATE_AnoBlack_EC1_Alum6061_v1o0_20251115.xls"
IMX455 = "IMX455_stageRotation0_20250922.xls"
MAGIC_BLACK = "MagicBlack_v2o0_20250902.xls"

WriteWorkbook = Callable[[Path, Any], Path]


@pytest.fixture(scope="module")
def ec1(goniometer: Path) -> BrdfMeasurement:
    return load_measurement(goniometer / EC1)


def in_plane(m: BrdfMeasurement, incidence: float, azimuth: float) -> BrdfMeasurement:
    assert m.azimuth_deg is not None
    return m.select(
        (m.azimuth_deg == azimuth) & np.isclose(m.incidence_deg, incidence) & (m.tilt_deg == 0)
    )


@pytest.mark.parametrize(
    ("name", "readings", "valid", "negative", "azimuths"),
    [(EC1, 2508, 2496, 5, 19), (IMX455, 2508, 2496, 729, 19), (MAGIC_BLACK, 2376, 2368, 2026, 18)],
)
def test_every_reading_of_a_real_workbook_arrives(
    goniometer: Path, name: str, readings: int, valid: int, negative: int, azimuths: int
) -> None:
    m = load_measurement(goniometer / name)
    assert (len(m), int(m.valid.sum())) == (readings, valid)
    assert m.channels == ("650nm",)
    assert int((m.values < 0).sum()) == negative
    assert m.azimuth_deg is not None
    assert len(np.unique(m.azimuth_deg)) == azimuths
    assert m.metadata.instrument == "J&C RT-300S"
    assert m.metadata.sample == Path(name).stem
    assert any(note.startswith(f"{negative} of {readings} values are") for note in m.metadata.notes)


@pytest.mark.parametrize(("incidence", "raw", "f_r"), [(30, 30, 35), (50, 55, 75), (70, 75, 80)])
def test_the_peak_of_rt_and_of_f_r_lie_where_the_raw_file_has_them(
    ec1: BrdfMeasurement, incidence: float, raw: float, f_r: float
) -> None:
    cut = in_plane(ec1, incidence, -90)
    assert len(cut) == 33
    assert cut.receiving_deg[np.argmax(cut.values[:, 0])] == f_r
    relative = cut.values[:, 0] * np.cos(np.deg2rad(cut.receiving_deg))
    assert cut.receiving_deg[np.argmax(relative)] == raw


def test_the_plane_of_incidence_is_at_azimuth_90_and_minus_90(ec1: BrdfMeasurement) -> None:
    """Rationale: a reading there lies in the plane; the mirror is at positive receiving at both."""
    assert ec1.azimuth_deg is not None
    flat = np.isin(ec1.azimuth_deg, (-90, 90))
    assert abs(ec1.tilt_deg[flat]).max() == 0
    assert set(np.round(ec1.incidence_deg[flat], 6)) == {10, 30, 50, 70}
    for azimuth in (-90, 90):
        cut = in_plane(ec1, 70, azimuth)
        assert cut.receiving_deg[np.argmax(cut.values[:, 0])] == 80
    assert abs(ec1.tilt_deg[ec1.azimuth_deg == 0]).max() > 60


def test_a_value_is_100_rt_over_cosine(ec1: BrdfMeasurement) -> None:
    """Expected: RT 0.119 at incidence 30, receive 30, azimuth −90, as a spreadsheet shows it."""
    cut = in_plane(ec1, 30, -90)
    value = cut.values[cut.receiving_deg == 30, 0]
    assert value == pytest.approx(100 * 0.119 / np.cos(np.deg2rad(30)))


def test_a_tenth_of_the_table_is_touched(ec1: BrdfMeasurement) -> None:
    angles = np.stack([ec1.incidence_deg, ec1.receiving_deg, ec1.tilt_deg], axis=1)
    cells = np.rint(angles / 5).astype(int)
    inside = (cells[:, 0] <= 14) & (abs(cells[:, 1:]) <= 14).all(axis=1)
    assert len(np.unique(cells[inside], axis=0)) == 1494  # of 15 x 29 x 29
    assert len(np.unique(cells[inside & ec1.valid], axis=0)) == 1488


def test_the_detector_in_front_of_the_lamp_sees_nothing(ec1: BrdfMeasurement) -> None:
    """Rationale: at receiving = −incidence RT falls to almost nothing."""
    hidden = ec1.select(~ec1.valid)
    assert abs(hidden.incidence_deg + hidden.receiving_deg).max() < 4
    assert np.median(abs(hidden.values)) < 0.1 * np.median(ec1.values)
    assert any("12 readings where the detector hides" in note for note in ec1.metadata.notes)


def test_the_stage_rotation_of_the_name_is_kept_apart(goniometer: Path) -> None:
    other = dict(load_measurement(goniometer / IMX455).metadata.other)
    assert other["stage rotation deg"].startswith("0,")
    assert other["date"] == "2011-03-08"


def test_it_survives_the_projects_own_format(ec1: BrdfMeasurement, tmp_path: Path) -> None:
    ec1.save(tmp_path / "ec1.csv")
    again = load_measurement(tmp_path / "ec1.csv")
    assert again == ec1


# -- synthetic workbooks ---------------------------------------------------------------------------


def rows_of(**columns: list[float | str | None]) -> list[list[float | str | None]]:
    return [[f" {name}", *cells] for name, cells in columns.items()]


READINGS: dict[str, list[float | str | None]] = {
    "Azimuth": [-90.0, -90.0, 90.0, 0.0],
    "Incidence": [30.0, 30.0, 30.0, 30.0],
    "Receive": [30.0, 100.0, -45.0, 0.0],
    "RT": [0.5, 0.1, 0.25, -0.01],
}


def test_readings_below_the_horizon_are_left_out(
    tmp_path: Path, write_workbook: WriteWorkbook
) -> None:
    m = load_measurement(write_workbook(tmp_path / "a.xls", rows_of(**READINGS)))
    np.testing.assert_allclose(m.incidence_deg, 30)
    np.testing.assert_allclose(m.receiving_deg, [30, 45, 0])
    np.testing.assert_allclose(m.values[:, 0], [50 / np.cos(np.pi / 6), 25 / np.cos(np.pi / 4), -1])
    assert "1 readings from at or below the horizon left out" in m.metadata.notes


def test_xyz_rows_are_used_where_they_are_filled(
    tmp_path: Path, write_workbook: WriteWorkbook
) -> None:
    xyz: dict[str, list[float | str | None]] = {name: [10.0, 1, 2, 3] for name in "XYZ"}
    head: dict[str, list[float | str | None]] = {"Illuminant.": ["A"] * 4, "Model ID": ["pearl"]}
    m = load_measurement(write_workbook(tmp_path / "a.xls", rows_of(**READINGS, **xyz, **head)))
    assert (m.channels, m.metadata.white, m.metadata.sample) == (("X", "Y", "Z"), "A", "pearl")
    np.testing.assert_allclose(m.values[0], 10 / np.cos(np.pi / 6))
    xyz["Z"][2] = None
    partly = load_measurement(write_workbook(tmp_path / "b.xls", rows_of(**READINGS, **xyz)))
    assert partly.channels == ("650nm",)


def test_several_wavelength_rows_are_bands(tmp_path: Path, write_workbook: WriteWorkbook) -> None:
    rows = rows_of(**READINGS)
    rows += [[500.0, 0.2, 0.2, 0.2, 0.2], [450.0, 0.1, 0.1, 0.1, 0.1], [550.0, None]]
    m = load_measurement(write_workbook(tmp_path / "a.xls", rows))
    assert m.channels == ("450nm", "500nm")
    np.testing.assert_allclose(m.values[-1], [10, 20])


def test_both_signs_of_receive_differ_at_normal_incidence(
    tmp_path: Path, write_workbook: WriteWorkbook
) -> None:
    """Rationale: they are half a turn of the sample apart, like at every other incidence."""
    columns: dict[str, list[float | str | None]] = {
        "Azimuth": [-90.0, -90.0, 0.0, 0.0],
        "Incidence": [0.0] * 4,
        "Receive": [-30.0, 30.0, -30.0, 30.0],
        "RT": [0.1, 0.2, 0.3, 0.4],
    }
    m = load_measurement(write_workbook(tmp_path / "a.xls", rows_of(**columns)))
    assert m.receiving_deg.tolist() == [-30, 30, -30, 30]
    assert not m.incidence_deg.any()
    assert not m.tilt_deg.any()


@pytest.mark.parametrize(
    ("row", "cells", "message"),
    [
        (
            "RT",
            [0.1, "high", 0.1, 0.1],
            r"sheet 'Sheet 1', cell C4: RT: expected a number, got 'high'",
        ),
        ("RT", [0.1, 0.1, None, 0.1], r"cell D4: RT: expected a number, got nothing"),
        ("Incidence", [1.0, 2.0, 3.0, 91.0], r"cell E2: Incidence: expected 0…90 degrees, got 91"),
        (
            "Azimuth",
            [1e9, 0.0, 0.0, 0.0],
            r"cell B1: Azimuth: expected -360…360 degrees, got 1e\+09",
        ),
        ("Incidence", [-1.0, 2.0, 3.0, 9.0], r"cell B2: Incidence: expected 0…90 degrees, got -1"),
    ],
)
def test_a_wrong_cell_is_named(
    tmp_path: Path, write_workbook: WriteWorkbook, row: str, cells: Any, message: str
) -> None:
    path = write_workbook(tmp_path / "a.xls", rows_of(**{**READINGS, row: cells}))
    with pytest.raises(InputError, match=message) as caught:
        load_measurement(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (
            [["name", "price"], ["tea", 3.0]],
            "column A: .*got no row named Azimuth, Incidence, Receive",
        ),
        (
            rows_of(**READINGS)[:3],
            "column A: expected a workbook of the RT-300S .*, got no row named RT",
        ),
        (
            [[cells[0]] for cells in rows_of(**READINGS)],
            "expected readings to the right of column A, got none",
        ),
        ([], "expected a workbook of the RT-300S, got empty sheets"),
    ],
)
def test_another_workbook_is_refused(
    tmp_path: Path, write_workbook: WriteWorkbook, rows: Any, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        load_measurement(write_workbook(tmp_path / "a.xls", rows))


@pytest.mark.parametrize("keep", [8, 511, 513, 1024, 100_000, 400_000, -512, -1])
def test_a_truncated_workbook_is_refused(goniometer: Path, tmp_path: Path, keep: int) -> None:
    cut = tmp_path / "cut.xls"
    cut.write_bytes((goniometer / EC1).read_bytes()[:keep])
    with pytest.raises(InputError, match="truncated") as caught:
        load_measurement(cut)
    assert str(caught.value).startswith(f"{cut}: ")
    assert "\n" not in str(caught.value)


def test_a_damaged_workbook_raises_nothing_else(goniometer: Path, tmp_path: Path) -> None:
    whole = (goniometer / EC1).read_bytes()
    rng = np.random.default_rng(7)
    for _ in range(60):
        data = bytearray(whole)
        places = rng.integers(8, 2048 if rng.random() < 0.5 else len(data), rng.integers(1, 200))
        for place in places:
            data[place] = rng.integers(256)
        path = tmp_path / "damaged.xls"
        path.write_bytes(data)
        try:
            load_measurement(path)
        except InputError as error:
            assert "\n" not in str(error)  # noqa: PT017


def test_a_cell_far_out_takes_no_memory(tmp_path: Path, write_workbook: WriteWorkbook) -> None:
    rows: list[list[float | str | None]] = [*rows_of(**READINGS), *([[]] * 16_000), [None] * 255]
    rows[-1] += [1.0]
    assert len(load_measurement(write_workbook(tmp_path / "a.xls", rows))) == 3


def test_a_workbook_too_large_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "large.xls"
    with path.open("wb") as file:
        file.write(bytes.fromhex("d0cf11e0a1b11ae1"))
        file.truncate(rt300s.MAX_BYTES + 1)
    with pytest.raises(InputError, match="expected at most 64 MB, got "):
        load_measurement(path)
