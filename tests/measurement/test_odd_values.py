"""What instruments and other programs write in place of a reflectance factor, or around it."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest

import raden_torch as rt
from raden_torch.errors import InputError

HEAD = "incidence_deg,receiving_deg,tilt_deg"


def changed(value: float, *, valid: bool = True) -> rt.BrdfMeasurement:
    values = np.full((4, 3), 20.0)
    values[2, 1] = value
    angles = np.arange(4.0)
    there = np.array([True, True, valid, True])
    return rt.BrdfMeasurement(angles, angles, angles, values, valid=there)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (9.9e37, "reading 3: Y: expected a finite reflectance factor, got 9.9e\\+37; mark"),
        (math.inf, "reading 3: Y: expected a finite reflectance factor, got inf; mark"),
        (-999.0, "reading 3: Y: expected a reflectance factor, got -999, which looks like a code"),
        (-9999.0, "reading 3: Y: expected a reflectance factor, got -9999"),
    ],
)
def test_codes_are_no_values(value: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        changed(value)
    if math.isfinite(value):
        assert not changed(value, valid=False).valid[2]
    assert changed(-1.5).values[2, 1] == -1.5  # noise


def test_bands_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text(
        f"{HEAD},600nm,500nm,550nm,std_600nm,std_500nm,std_550nm\n1,2,3,6,5,5.5,.6,.5,.55\n"
    )
    found = rt.load_measurement(path)
    assert found.channels == ("500nm", "550nm", "600nm")
    assert found.values.tolist() == [[5, 5.5, 6]]
    assert found.std is not None
    assert found.std.tolist() == [[0.5, 0.55, 0.6]]


def test_a_turn_is_no_other_azimuth(analytic) -> None:
    m = analytic(step=35.0)
    columns = {
        name: np.tile(getattr(m, f"{name}_deg"), 2) for name in ("incidence", "receiving", "tilt")
    }
    azimuth = np.repeat([0.0, 360.0], len(m))
    twice = rt.BrdfMeasurement(*columns.values(), np.tile(m.values, (2, 1)), azimuth_deg=azimuth)
    assert twice.azimuths == 1
    np.testing.assert_array_equal(twice.grid().values, m.grid().values)
    with pytest.raises(InputError, match="same geometry"):
        rt.BrdfMeasurement(
            *columns.values(), np.concatenate([m.values, 3 * m.values]), azimuth_deg=azimuth
        )


@pytest.mark.parametrize(("noise", "off"), [(0.004, "0.004"), (0.04, "0.04")])
def test_angles_as_encoders_read_them(analytic, noise: float, off: str) -> None:
    m = analytic(step=17.5)
    rng = np.random.default_rng(1)
    moved = (
        np.clip(a + rng.uniform(-noise, noise, len(m)), low, 90)
        for a, low in ((m.incidence_deg, 0), (m.receiving_deg, -90), (m.tilt_deg, -90))
    )
    near = rt.fit(rt.BrdfMeasurement(*moved, m.values), interpolation="trilinear")
    on = rt.fit(m, interpolation="trilinear")
    np.testing.assert_array_equal(near.model.table.values.detach(), on.model.table.values.detach())
    assert f"angles up to {off} deg off a grid were taken as on it" in str(near.report)


def test_nothing_reflects_and_another_unit(analytic) -> None:
    m = analytic(step=35.0)
    with pytest.raises(InputError, match="got no value above 0"):
        rt.fit(rt.BrdfMeasurement(m.incidence_deg, m.receiving_deg, m.tilt_deg, 0 * m.values))
    unit = rt.BrdfMeasurement(m.incidence_deg, m.receiving_deg, m.tilt_deg, m.values / 100)
    assert "multiply its values by 100" in str(rt.fit(unit, interpolation="trilinear").report)
    assert "multiply" not in str(rt.fit(m, interpolation="trilinear").report)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are POSIX's")
def test_a_pipe_is_refused_by_its_name(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for read in (rt.load_measurement, rt.load_model):
        with pytest.raises(InputError, match="pipe: expected a file, got a pipe"):
            read(pipe)
