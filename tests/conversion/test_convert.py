"""Files that are written hold what they should, read by code of the tests' own, and come back."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import raden_torch as rt
from raden_torch.capture.exchange import merl
from raden_torch.capture.exchange.polar import by_directions
from raden_torch.conversion.convert import convert
from raden_torch.conversion.options import Options
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import FACTOR_PER_SR, RGB, XYZ


def _beside(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


truth = _beside("truth")
INCIDENCE, RADIAL = (10.0, 30.0, 55.0), (0.0, 10.0, 25.0, 60.0)
AROUND = tuple(range(0, 360, 30))


def angles_of(light: np.ndarray, view: np.ndarray) -> np.ndarray:
    """`[M, 3]` incidence, receiving and tilt in degrees of unit vectors `[M, 3]`."""
    normal = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).view(3, 1, 1)
    maps = (torch.from_numpy(v.T.copy())[:, :, None] for v in (light, view))
    return np.rad2deg(torch.cat(rt.raden_angles(normal, *maps))[..., 0].numpy().T)


def measured(
    light: np.ndarray, view: np.ndarray, lopsided: float = 0.05, **about: object
) -> BrdfMeasurement:
    """The known reflection at these directions."""
    a, r, t = angles_of(light, view).T
    values = FACTOR_PER_SR * truth.f_r(light, view, lopsided=lopsided)
    return BrdfMeasurement(a, r, t, values, **about)  # type: ignore[arg-type]


def turned(v: np.ndarray, c: np.ndarray, s: np.ndarray) -> np.ndarray:
    """About y, by the angles with these cosines and sines."""
    return np.stack([c * v[:, 0] + s * v[:, 2], v[:, 1], c * v[:, 2] - s * v[:, 0]], 1)


def about(axis: str) -> tuple[np.ndarray, np.ndarray]:
    """Directions of a grid about the normal or the specular direction, above the horizon."""
    i, a, r = (np.deg2rad(x.ravel()) for x in np.meshgrid(INCIDENCE, AROUND, RADIAL, indexing="ij"))
    keep = (r > 0) | (a == 0)
    i, a, r = i[keep], a[keep], r[keep]
    light, view = truth.polar(i, np.full_like(i, np.pi)), truth.polar(r, a)
    if axis == "specular":
        c, s = np.cos(i), np.sin(i)  # turned about y, so that z becomes S
        view = turned(view, c, s)
    above = view[:, 2] > 1e-6
    return light[above], view[above]


GRID = {name: "specular" if name == "zemax" else "normal" for name in truth.READERS}


@pytest.mark.parametrize("name", GRID)
@pytest.mark.parametrize("lopsided", [0.0, 0.05])
def test_a_file_holds_the_formula_at_its_directions(
    tmp_path: Path, name: str, lopsided: float
) -> None:
    """Rationale: angles, signs of azimuths, units and the order of channels are read from the file
    by the format's own documents, not by our reader. Expectation: nine digits."""
    suffix, reader = truth.READERS[name]
    path = tmp_path / f"a{suffix}"
    m = measured(*about(GRID[name]), lopsided, metadata=Metadata("card"))
    done = convert(m, path, Options(to=name))
    assert (done.as_read >= len(m), done.interpolated, done.continued) == (True, 0, 0)
    light, view, f = reader(path)
    known = (f > 0).all(axis=1) & (view[:, 2] > 1e-6)
    assert known.sum() >= (len(m) if name != "zemax" or lopsided else len(m) / 2)
    expected = truth.f_r(light[known], view[known], lopsided=lopsided)
    if f.shape[1] == 1:
        expected = expected[:, 1:2]  # Y
    np.testing.assert_allclose(f[known], expected, rtol=5e-8)


@pytest.mark.parametrize("name", GRID)
def test_a_file_comes_back(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"a{truth.READERS[name][0]}"
    m = measured(*about(GRID[name]), metadata=Metadata("card", simulated=True))
    convert(m, path, Options(to=name))
    back = by_directions(rt.load_measurement(path))[0]
    one = convert(m, tmp_path / "b.csv", Options(channel="Y" if len(back.channels) == 1 else None))
    assert one.lost == () or "only Y" in one.lost[0]
    _check_equal(back, by_directions(rt.load_measurement(tmp_path / "b.csv"))[0])
    if name != "fred":
        assert (back.metadata.sample, back.metadata.simulated) == ("card", True)


def _check_equal(back: BrdfMeasurement, m: BrdfMeasurement, rtol: float = 1e-8) -> None:
    """The same readings in any order."""
    assert len(back) == len(m)
    columns = [np.round(x.angles_deg, 4) for x in (back, m)]
    turned = [np.zeros(len(m))] * 2
    if m.azimuth_deg is not None:
        turned = [np.round(x.azimuth_deg, 6) % 360 for x in (back, m)]
    order = [np.lexsort(np.column_stack([c, t]).T) for c, t in zip(columns, turned, strict=True)]
    np.testing.assert_allclose(turned[0][order[0]], turned[1][order[1]], atol=1e-5)
    np.testing.assert_allclose(back.angles_deg[order[0]], m.angles_deg[order[1]], atol=2e-5)
    np.testing.assert_allclose(back.values[order[0]], m.values[order[1]], rtol=rtol)


@pytest.mark.parametrize("name", ["astm", "zemax", "lighttools", "speos"])
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32 - 1), turns=st.integers(1, 3), steps=st.integers(3, 8))
def test_readings_on_any_grid_come_back(
    tmp_path: Path, name: str, seed: int, turns: int, steps: int
) -> None:
    """Random axes, values over seven decades, and the sample at several azimuths."""
    random = np.random.default_rng(seed)
    axes = (
        np.sort(random.choice(np.arange(0, 360, 15.0), turns, replace=False)),
        np.sort(random.choice(np.arange(5, 80, 2.5), 2, replace=False)),
        360 * np.arange(steps) / steps,
        np.sort(random.choice(np.arange(2, 85, 1.5), 4, replace=False)),
    )
    azimuths, i, a, r = (x.ravel() for x in np.meshgrid(*axes, indexing="ij"))
    light, view = (truth.polar(*np.deg2rad(x)) for x in ((i, np.full_like(i, 180)), (r, a)))
    if name == "zemax":
        c, s = np.cos(np.deg2rad(i)), np.sin(np.deg2rad(i))
        view = turned(view, c, s)
    up = view[:, 2] > 1e-3
    incidence, receiving, tilt = angles_of(light[up], view[up]).T
    values = 10.0 ** random.uniform(-3, 4, (int(up.sum()), 3))
    azimuth = azimuths[up] if turns > 1 or axes[0][0] else None
    m, merged = by_directions(
        BrdfMeasurement(incidence, receiving, tilt, values, azimuth_deg=azimuth)
    )
    assume(not merged)
    path = tmp_path / f"a{truth.READERS[name][0]}"
    if name == "speos":
        m = replace(m, values=m.values[:, 1:2], channels=("550nm",))
    done = convert(m, path, Options(to=name))
    if name != "astm" and done.interpolated:
        assume(False)  # too few above the horizon to show their grid
    _check_equal(by_directions(rt.load_measurement(path))[0], m)


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32 - 1), channels=st.sampled_from([XYZ, RGB, ("420nm", "610.5nm")]))
def test_scattered_readings_come_back_from_a_list(
    tmp_path: Path, seed: int, channels: tuple[str, ...]
) -> None:
    random = np.random.default_rng(seed)
    a, r, t = random.uniform([1, -80, -80], [80, 80, 80], (40, 3)).T
    keep = abs(a + r) > 1
    values = random.normal(20, 30, (40, len(channels)))  # noise below 0, too
    m = BrdfMeasurement(a[keep], r[keep], t[keep], values[keep], channels)
    convert(m, tmp_path / "a.astm")
    back = rt.load_measurement(tmp_path / "a.astm")
    assert back.channels == channels
    _check_equal(back, m, rtol=1e-12)
    convert(m, tmp_path / "a.txt", Options(to="fred", channel=channels[0]))
    one = rt.load_measurement(tmp_path / "a.txt")
    expected = replace(m, values=np.maximum(m.values[:, :1], 0), channels=one.channels)
    _check_equal(one, expected)


@pytest.fixture(scope="module")
def merl_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A MERL file of the known reflection, by a writer of the tests' own; some cells are holes."""
    path = tmp_path_factory.mktemp("merl") / "known.binary"
    h = np.deg2rad((np.arange(90) + 0.5) ** 2 / 90)
    d, p = np.deg2rad(np.arange(90) + 0.5), np.deg2rad(np.arange(180) + 0.5)
    h, d, p = (x.ravel() for x in np.meshgrid(h, d, p, indexing="ij"))
    x, y, z = np.sin(d) * np.cos(p), np.sin(d) * np.sin(p), np.cos(d)
    c, s = np.cos(h), np.sin(h)
    light = np.stack([c * x + s * z, y, c * z - s * x], 1)
    view = np.stack([-c * x + s * z, -y, c * z + s * x], 1)
    table = truth.f_r(light, view, lopsided=0.0) / (np.array([1.0, 1.15, 1.66]) / 1500)
    table[(light[:, 2] <= 0) | (view[:, 2] <= 0)] = -1
    table[::1009] = -1
    with path.open("wb") as file:
        file.write(np.array([90, 90, 180], "<i4").tobytes())
        file.write(table.T.astype("<f8").tobytes())
    return path


@pytest.mark.slow
def test_merl_cells_are_read_and_written_where_they_are(merl_file: Path, tmp_path: Path) -> None:
    """Rationale: the cells' geometry is Matusik's, turned by the tests' own code; values are the
    formula's at our angles. Expectation: rounding, holes kept, and the file again to 1e-14."""
    m = rt.load_measurement(merl_file)
    assert m.channels == RGB
    assert "holes" in " ".join(m.metadata.notes)
    some = np.random.default_rng(0).choice(len(m), 4000, replace=False)
    kept = m.select(some)
    kept = kept.select(kept.valid)
    light, view = (
        v[..., 0].T.numpy()
        for v in rt.vectors_from_angles(
            *(torch.from_numpy(np.deg2rad(x))[None, :, None] for x in kept.angles_deg.T)
        )[1:]
    )
    expected = FACTOR_PER_SR * truth.f_r(light, view, lopsided=0.0)
    np.testing.assert_allclose(kept.values, expected, rtol=1e-7)
    done = convert(m, tmp_path / "again.binary")
    assert (done.as_read, done.interpolated, done.continued) == (int(m.valid.sum()), 0, 0)
    assert done.empty == int((~m.valid).sum())
    first, again = (
        np.frombuffer(p.read_bytes(), "<f8", offset=12)
        for p in (merl_file, tmp_path / "again.binary")
    )
    assert ((first < 0) == (again < 0)).all()
    np.testing.assert_allclose(again, first, rtol=1e-13)


@pytest.mark.slow
def test_merl_readers_find_a_model_in_their_cells(tmp_path: Path) -> None:
    """Rationale: Matusik's look-up, in the tests' own code, of random directions. Expectation: the
    middle of each cell is right to within a cell: least of all the error changes sign."""
    light = np.random.default_rng(1).normal(size=(3000, 3))
    view = np.random.default_rng(2).normal(size=(3000, 3))
    for v in (light, view):
        v[:, 2] = abs(v[:, 2]) + 0.2
        v /= np.linalg.norm(v, axis=1, keepdims=True)
    nodes = merl.nodes()
    l0, v0 = (x.T for x in merl.cell_directions())
    f = np.full((merl.CELLS, 3), np.nan)
    f[nodes.above] = truth.f_r(l0[nodes.above], v0[nodes.above], lopsided=0.0)
    merl.write(tmp_path / "a.binary", f)
    table = np.frombuffer((tmp_path / "a.binary").read_bytes(), "<f8", offset=12).reshape(3, -1).T
    found = table[truth.merl_index(light, view)] * np.array([1.0, 1.15, 1.66]) / 1500
    expected = truth.f_r(light, view, lopsided=0.0)
    known = (found >= 0).all(axis=1)
    assert known.mean() > 0.99
    error = (found / expected - 1)[known]
    assert abs(error).max() < 0.25  # the lobe's flank, a cell of a degree and a half wide
    assert abs(error).mean() < 0.006
    assert abs(error.mean()) < 0.001


def test_a_model_fills_the_hemisphere(tmp_path: Path) -> None:
    """Expectation: the file holds the model at its directions, and says how much is continued."""
    model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
    path = tmp_path / "a.anisotropicbsdf"
    done = convert(model, path, Options(step_deg=15))
    assert done.as_read == done.empty == 0
    assert min(done.interpolated, done.continued) > 100
    light, view, f = truth.read_speos(path)
    a, r, t = (torch.from_numpy(np.deg2rad(x))[None, :, None] for x in angles_of(light, view).T)
    with torch.no_grad():
        rgb = model.fit_form(a, r, t)[:, :, 0].T.numpy()
    luminance = rgb @ np.array([0.2126, 0.7152, 0.0722])
    seen = f[:, 0] > 0
    np.testing.assert_allclose(f[seen, 0], luminance[seen], rtol=2e-3)  # rounded primaries
    one = convert(model, tmp_path / "a.csv", Options(step_deg=40))
    assert "beyond the measured angles" in one.lost[1]
    back = rt.load_measurement(tmp_path / "a.csv")
    assert back.metadata.simulated
    assert "values of a model" in back.metadata.notes[0]


def test_holes_are_left_where_nothing_was_measured(tmp_path: Path) -> None:
    m = rt.simulate_specimen("akoya", step_deg=35)
    done = convert(m, tmp_path / "a.bsdf", Options(to="lighttools", step_deg=30, holes=True))
    assert done.continued == 0
    assert done.empty > 0
    _, _, f = truth.read_lighttools(tmp_path / "a.bsdf")
    assert (f == 0).all(axis=1).sum() >= done.empty


def test_what_is_lost_is_said(tmp_path: Path) -> None:
    """Expectation: every column and reading that the other file has no room for, in one line."""
    light, view = about("normal")
    m = measured(light, view, metadata=Metadata("shell", white="D50"))
    valid = np.ones(len(m), bool)
    valid[:3] = False
    noisy = replace(m, std=0.1 * m.values, count=np.full(len(m), 2), valid=valid)
    lost = str(convert(noisy, tmp_path / "a.txt", Options(to="fred"))).splitlines()[1]
    for what in ("X, Z (only Y", "3 readings that are not valid", "uncertainties", "counts"):
        assert what in lost
    assert "wavelength" in lost
    lost = str(convert(noisy, tmp_path / "a.astm"))
    assert "white D50" in lost
    assert np.allclose(  # D50's white becomes D65's
        rt.load_measurement(tmp_path / "a.astm").as_rgb().values.mean(axis=0),
        noisy.select(valid).as_rgb().values.mean(axis=0),
    )


def test_sample_azimuths_are_refused_by_isotropic_formats_unless_averaged(tmp_path: Path) -> None:
    """Rationale: two azimuths whose values differ by a tenth. Expectation: the refusal says how far
    apart they lie; their mean, on request."""
    m = measured(*about("normal"))
    both = BrdfMeasurement(
        *(np.tile(x, 2) for x in m.angles_deg.T),
        np.concatenate([0.95 * m.values, 1.05 * m.values]),
        azimuth_deg=np.repeat([0.0, 90.0], len(m)),
    )
    with pytest.raises(InputError, match=r"FRED holds isotropic .* got 2; .* lay 5 % off"):
        convert(both, tmp_path / "a.txt", Options(to="fred"))
    with pytest.raises(InputError, match="MERL holds isotropic"):
        convert(both, tmp_path / "a.binary")
    done = convert(both, tmp_path / "a.txt", Options(to="fred", average=True))
    assert "the sample's 2 azimuths" in done.lost
    assert "lay 5 % off" in " ".join(done.lost)
    mean = rt.load_measurement(tmp_path / "a.txt")
    _check_equal(mean, replace(m, values=m.values[:, 1:2], channels=mean.channels))


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("a.bsdf", {}, "expected `to`, one of zemax, lighttools, .* files .bsdf"),
        ("a.txt", {}, "expected `to`, one of astm, zemax, lighttools, fred, speos"),
        ("a.png", {}, "expected a suffix of a format or `to`, one of csv .* got .png"),
        ("a.bsdf", {"to": "tiff"}, "to: expected one of csv, astm, merl, .* got 'tiff'"),
        ("a.csv", {"to": "merl"}, "ends in .binary, got .csv"),
        (
            "a.bsdf",
            {"to": "zemax", "step_deg": 0.01},
            "at most 6000000 values, got 1 x 8501 x 36000",
        ),
        ("a.astm", {"channel": "550nm"}, "channel: expected one of X, Y, Z, got '550nm'"),
        ("a.bsdf", {"to": "zemax", "step_deg": 0.0}, "step_deg: expected above 0"),
        ("a.binary", {"step_deg": 1.0}, "step_deg: expected with another format than MERL"),
    ],
)
def test_requests_that_cannot_be_met_are_one_line(
    tmp_path: Path, name: str, options: dict[str, object], message: str
) -> None:
    m = rt.simulate_specimen("akoya", step_deg=35)
    with pytest.raises(InputError, match=message) as caught:
        convert(m, tmp_path / name, Options(**options))  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_bands_without_a_colour_ask_for_one(tmp_path: Path) -> None:
    m = measured(*about("normal"))
    bands = replace(m, channels=("400nm", "500nm", "600nm"))
    with pytest.raises(InputError, match="bands that make no colour: expected `channel`, one of"):
        convert(bands, tmp_path / "a.bsdf", Options(to="zemax", step_deg=30))
    done = convert(bands, tmp_path / "a.bsdf", Options(to="lighttools", channel="500nm"))
    assert done.lost[0] == "400nm, 600nm (only 500nm is kept)"
    assert rt.load_measurement(tmp_path / "a.bsdf").channels == ("500nm",)


def test_the_command_says_what_it_did(raden: Callable[..., object], tmp_path: Path) -> None:
    source = tmp_path / "shell.csv"
    rt.simulate_specimen("akoya", step_deg=35).save(source)
    ran = raden("convert", source, tmp_path / "shell.astm")
    assert ran.returncode == 0
    assert ran.stdout.splitlines()[1].startswith("lost: ")
    ran = raden("convert", source, tmp_path / "a.txt", "--to", "fred", "--channel", "X", "--json")
    said = json.loads(ran.stdout)
    assert (said["format"], said["as_read"]) == ("fred", said["places"])
    assert any("only X" in phrase for phrase in said["lost"])
    for words, message in (
        ([source, source], "is also an input"),
        ([source, tmp_path / "a.bsdf"], "expected --to, one of zemax, lighttools"),
        ([source, tmp_path / "a.bsdf", "--to", "zemax", "--step", "0.01"], "a larger --step makes"),
        ([tmp_path / "none.csv", tmp_path / "a.astm"], "No such file"),
    ):
        ran = raden("convert", *words)
        assert ran.returncode == 2
        assert message in ran.stderr
        assert ran.stderr.count("\n") == 1


def test_real_files_of_other_programs_are_converted(shared: Path, tmp_path: Path) -> None:
    """Expectation: Zemax's table again to nine digits, but for its zeros; a goniometer's azimuths
    as one, as its users' scripts write FRED files; its exports as a list."""
    folder = shared / "data/goniometer_rt300s"
    source = folder / "ValidationTest_of_TIS_via_BrownVinyl.bsdf"
    vinyl = rt.load_measurement(source)
    convert(vinyl, tmp_path / "a.bsdf", Options(to="zemax"))
    light, view, f = truth.read_zemax(tmp_path / "a.bsdf")
    light0, view0, f0 = truth.read_zemax(source)
    near0, near = (np.round(np.hstack([l0, v]), 7) for l0, v in ((light0, view0), (light, view)))
    known = {tuple(row): value for row, value in zip(near0, f0[:, 0], strict=True)}
    again = {tuple(row): value for row, value in zip(near, f[:, 0], strict=True) if value}
    assert len(again) > 600
    for row, value in again.items():
        assert abs(value - known[row]) < 1e-8
    assert "PlaneSymmetrical" in (tmp_path / "a.bsdf").read_text("utf-8")
    xls = rt.load_measurement(folder / "MagicBlack_v2o0_20250902.xls")
    with pytest.raises(InputError, match="sample azimuth, or `average`, got 18"):
        convert(xls, tmp_path / "a.txt", Options(to="fred"))
    done = convert(xls, tmp_path / "a.txt", Options(to="fred", average=True))
    assert done.as_read > 1000
    assert "noise" in done.lost[-1]
    light, view, f = truth.read_fred(tmp_path / "a.txt")
    assert ((f >= 0).all(), bool((light[:, 2] > 0).all())) == (True, True)
    export = rt.load_measurement(folder / "test_speos.rtd")
    done = convert(export, tmp_path / "a.astm")
    _check_equal(rt.load_measurement(tmp_path / "a.astm"), by_directions(export)[0])
