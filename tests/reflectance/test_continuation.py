"""A table continued to the horizon: what must hold for any table, and how near truth it comes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import raden_torch as rt
from raden_torch.arrays import Floats
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.continuation import FLOOR, continued, log_change, look_into
from raden_torch.reflectance.grid import AngleGrid
from raden_torch.reflectance.interpolation import interpolate

BOX = np.array([[0.0, -70.0, -70.0], [70.0, 70.0, 70.0]])


def axes_of(box: float = 70, step: float = 5) -> AngleGrid:
    both = np.arange(-box, box + 1e-6, step)
    return AngleGrid(np.arange(0, box + 1e-6, step), both, both)


def nodes(axes: AngleGrid) -> Floats:
    return axes.nodes_deg()


def continue_outside(axes: AngleGrid, values: Floats) -> tuple[AngleGrid, Floats]:
    """The table that the paper's interpolation makes of the whole hemisphere."""
    function = continued(interpolate(axes, values, "trilinear"), values)
    whole = function(function.grid.nodes_deg().reshape(-1, 3))
    return function.grid, whole.reshape(*function.grid.shape, -1)


def logs_outside(look: Callable[[Floats], Floats], q: Floats, box: Floats) -> Floats:
    return look(q) + log_change(look, q, box)


def glossy(angles_deg: Floats) -> Floats:
    """A body and a rough metallic coat: GGX with Smith's shadowing (alpha 0.3) and Schlick's
    Fresnel, reciprocal and the same on equivalents."""
    a, r, t = np.moveaxis(np.deg2rad(angles_deg), -1, 0)
    half, facet = np.cos((a - r) / 2) * np.cos(t), np.cos((a + r) / 2)
    light, view = np.cos(a) * np.cos(t), np.cos(r) * np.cos(t)
    alpha = 0.3
    lobe = alpha**2 / (1 - (1 - alpha**2) * half**2) ** 2
    shadow = [2 * c / (c + np.sqrt(alpha**2 + (1 - alpha**2) * c**2)) for c in (light, view)]
    fresnel = 0.5 + 0.5 * (1 - abs(facet)) ** 5
    y = 5 + 100 * fresnel * lobe * shadow[0] * shadow[1] / (4 * light * view)
    return np.asarray(y[..., None] * [0.8, 1.0, 1.2])


def directions(count: int, to_deg: float, seed: int = 0) -> Floats:
    """Geometries outside the box with both angles to the normal below `to_deg`."""
    q = np.random.default_rng(seed).uniform(-to_deg, to_deg, (20 * count, 3))
    q[:, 0] = abs(q[:, 0])
    cosines = np.cos(np.deg2rad(q[:, :2])) * np.cos(np.deg2rad(q[:, 2:]))
    kept = (cosines > np.cos(np.deg2rad(to_deg))).all(axis=1) & (abs(q) > BOX[1]).any(axis=1)
    return q[kept][:count]


@pytest.fixture
def rough() -> Floats:
    """A table of noise over seven decades, with zeros."""
    rng = np.random.default_rng(1)
    values = 10 ** rng.uniform(-2, 5, (15, 29, 29, 3))
    values[rng.random(values.shape[:3]) < 0.1] = 0
    return values


@pytest.mark.parametrize("value", [0.0, 0.02, 100.0])
def test_a_perfect_diffuser_stays_one(value: float) -> None:
    _, whole = continue_outside(axes_of(), np.full((15, 29, 29, 3), value))
    np.testing.assert_allclose(whole, value, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("box", "step", "shape", "last"),
    [
        (70, 5, (19, 37, 37), 90),
        (60, 5, (19, 37, 37), 90),
        (70, 10, (10, 19, 19), 90),
        (60, 10, (10, 19, 19), 90),
        (70, 2.5, (37, 73, 73), 90),
        (67.5, 7.5, (13, 25, 25), 90),
        (64, 8, (13, 25, 25), 96),
    ],
)
def test_every_geometry_lies_in_the_table_and_the_box_is_untouched(
    box: float, step: float, shape: tuple[int, ...], last: float
) -> None:
    axes = axes_of(box, step)
    values = glossy(nodes(axes))
    whole_axes, whole = continue_outside(axes, values)
    assert whole.shape == (*shape, 3)
    assert [axis[0] for axis in whole_axes] == pytest.approx([0, -last, -last])
    assert [axis[-1] for axis in whole_axes] == pytest.approx([last] * 3)
    inside = np.ix_(*[np.isin(w, a) for w, a in zip(whole_axes, axes, strict=True)])
    np.testing.assert_allclose(whole[inside], values, rtol=1e-12)
    assert np.isfinite(whole).all()
    assert whole.min() > 0


def test_an_incidence_that_starts_late_is_held_below() -> None:
    axes = AngleGrid(np.arange(10, 71, 5.0), *axes_of()[1:])
    whole_axes, whole = continue_outside(axes, glossy(nodes(axes)))
    assert whole_axes[0][0] == 0
    np.testing.assert_allclose(whole[0, 4:-4, 4:-4], whole[2, 4:-4, 4:-4], rtol=1e-9)


@pytest.mark.parametrize(
    "low_high",
    [
        ((0, 70), (0, 70), (-70, 70)),
        ((0, 70), (-70, 70), (0, 70)),
        ((0, 60), (-40, 70), (-20, 35)),
        ((0, 20), (-20, 20), (-20, 20)),
        ((40, 70), (50, 70), (-70, 70)),
    ],
)
def test_faces_near_the_normal_hold_their_value(low_high: tuple[tuple[int, int], ...]) -> None:
    """Nothing was learnt from such boxes: a highlight of 20 to 100 must not run away."""
    axes = AngleGrid(*(np.arange(low, high + 1, 5.0) for low, high in low_high))
    a, r, t = np.moveaxis(np.deg2rad(nodes(axes)), -1, 0)
    half = np.arccos(np.clip(np.cos((a - r) / 2) * np.cos(t), -1, 1))
    values = np.repeat(20 + 80 * np.exp(-(half**2) / 0.08)[..., None], 3, axis=3)
    _, whole = continue_outside(axes, values)
    assert whole.max() < 130
    assert whole.min() > 12


def test_a_table_that_reaches_the_horizon_is_whole() -> None:
    axes = axes_of(90)
    values = np.random.default_rng(0).uniform(0, 100, (19, 37, 37, 3))
    whole_axes, whole = continue_outside(axes, values)
    np.testing.assert_allclose(whole, values, rtol=1e-12)
    assert all((w == a).all() for w, a in zip(whole_axes, axes, strict=True))


def test_noise_over_seven_decades_gives_finite_values_in_bounds(rough: Floats) -> None:
    _, whole = continue_outside(axes_of(), rough)
    assert np.isfinite(whole).all()
    assert whole.min() >= 0
    assert whole.max() <= np.exp(2.0) * (rough.max() + FLOOR)


def test_it_is_continuous_at_the_faces_and_beyond(rough: Floats) -> None:
    look = look_into(axes_of(), np.log(FLOOR + rough))
    q = directions(2000, 89)
    held = np.clip(q, *BOX)
    just_outside = held + 1e-7 * np.sign(q - held)
    np.testing.assert_allclose(logs_outside(look, just_outside, BOX), look(held), atol=1e-4)
    beside = np.clip(q + 1e-7 * np.random.default_rng(2).normal(size=q.shape), *(BOX * 90 / 70))
    np.testing.assert_allclose(
        logs_outside(look, beside, BOX), logs_outside(look, q, BOX), atol=1e-3
    )


def test_equivalents_stay_equal(rough: Floats) -> None:
    rough[0] = (rough[0] + rough[0, ::-1, ::-1]) / 2
    _, whole = continue_outside(axes_of(), rough)
    np.testing.assert_allclose(whole[0], whole[0, ::-1, ::-1], rtol=1e-9)


def test_what_is_reciprocal_stays_so() -> None:
    axes = axes_of()
    _, whole = continue_outside(axes, glossy(nodes(axes)))
    forward = whole[:, 18:]  # receiving >= 0
    np.testing.assert_allclose(forward, forward.swapaxes(0, 1)[:, :, ::-1], rtol=1e-9)
    back = whole[:, 18::-1]  # receiving <= 0: (a, r, t) and (−r, −a, t)
    np.testing.assert_allclose(back, back.swapaxes(0, 1), rtol=1e-9)


def test_other_units_of_a_bright_table_are_only_a_factor() -> None:
    values = glossy(nodes(axes_of()))
    _, once = continue_outside(axes_of(), values)
    _, thrice = continue_outside(axes_of(), 3 * values)
    np.testing.assert_allclose(thrice, 3 * once, rtol=1e-3)


def errors(table: Floats, axes: AngleGrid, q: Floats, truth: Floats) -> tuple[float, float, float]:
    """The median relative error of Y, that of the held edge, and the ratio of mean |Δ log(1+Y)|."""
    look = look_into(axes, np.log(FLOOR + table))
    low_high = np.array([[axis[0], axis[-1]] for axis in axes]).T
    y = np.maximum(np.exp(logs_outside(look, q, low_high)) - FLOOR, 0)[:, 1]
    held = np.maximum(np.exp(look(q)) - FLOOR, 0)[:, 1]
    relative = [np.median(abs(x - truth) / np.maximum(truth, FLOOR)) for x in (y, held)]
    log = [np.mean(abs(np.log1p(x) - np.log1p(truth))) for x in (y, held)]
    return float(relative[0]), float(relative[1]), float(log[0] / log[1])


def test_an_analytic_gloss_is_continued() -> None:
    axes = axes_of()
    q = directions(3000, 80)
    error, held, ratio = errors(glossy(nodes(axes)), axes, q, glossy(q)[:, 1])
    assert error < 0.02 < 0.04 < held
    assert ratio < 0.3


@pytest.mark.parametrize("name", ["yakogai"])
def test_a_simulated_shell_is_continued(name: str) -> None:
    """Nothing was learnt from shells."""

    def simulated(angles_deg: Floats) -> Floats:
        flat = rt.simulate_specimen(name, geometries_deg=angles_deg.reshape(-1, 3)).as_xyz().values
        return np.maximum(flat, 0).reshape(*angles_deg.shape[:-1], 3)

    axes, q = axes_of(), directions(400, 80)
    error, held, ratio = errors(simulated(nodes(axes)), axes, q, simulated(q)[:, 1])
    assert error < 0.06 < held
    assert ratio < 0.6


def test_real_materials_are_continued(shared: Path) -> None:
    """A regression check: the weights were learnt from these materials, among others. What they do
    for materials they have not seen is in docs/decisions/0017-outside-the-box.md."""
    found = []
    folder = shared / "data" / "whole_hemisphere"
    for name in ("nickel", "pearl-paint", "red-fabric2", "color-changing-paint1", "white-paint"):
        grid = rt.load_measurement(folder / f"{name}.csv").grid()
        test = rt.load_measurement(folder / f"{name}.hemisphere.csv")
        q = np.stack([test.incidence_deg, test.receiving_deg, test.tilt_deg], axis=1)
        outside = (abs(q) > BOX[1]).any(axis=1)
        found.append(errors(grid.values, grid.axes_deg, q[outside], test.values[outside, 1]))
    error, held, ratio = np.median(found, axis=0)
    assert error < 0.03 < 0.06 < held
    assert ratio < 0.6


@pytest.mark.parametrize("scheme", ["trilinear", "lobes"])
def test_the_function_goes_on_from_its_interpolant(scheme: str) -> None:
    """No step at the faces, nor where following the ridge ends; narrow ridges included."""
    axes = axes_of()
    a, r, t = np.moveaxis(nodes(axes), -1, 0)
    narrow = 1 + 300 * np.exp(-(((r - a) / 6) ** 2) - (t / 4) ** 2)
    inner = interpolate(axes, np.repeat(narrow[..., None], 3, axis=3), scheme)
    function = continued(inner, np.repeat(narrow[..., None], 3, axis=3))
    q = directions(2000, 89)
    held = np.clip(q, *BOX)
    np.testing.assert_allclose(
        function(held + 1e-7 * np.sign(q - held)), inner(held), rtol=1e-4, atol=1e-4
    )
    step = 1e-6 * np.random.default_rng(3).normal(size=q.shape)
    np.testing.assert_allclose(function(q + step), function(q), rtol=1e-3, atol=1e-3)


def test_a_fine_grid_of_a_small_box_stays_small() -> None:
    """On its steps, 0.25 degrees, a table to the horizon would have 188 million nodes."""
    step = np.arange(-10, 10.01, 0.25)
    angles = AngleGrid(np.arange(0, 10.01, 0.25), step, step).nodes_deg().reshape(-1, 3)
    a, r, t = angles.T
    y = 50 + 50 * np.exp(-(((r - a) / 3) ** 2) - (t / 3) ** 2)
    result = rt.fit(BrdfMeasurement(a, r, t, y[:, None] * np.ones(3)), interpolation="trilinear")
    assert result.model.table.values.shape == (41, 81, 81, 3)
    assert result.report.outside == "diffuse"
    assert any("361 x 721 x 721 nodes" in warning for warning in result.report.warnings)
