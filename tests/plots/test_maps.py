"""Maps, the polar curve, the ridge and uncertainties: they draw what was measured and stated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

import raden_torch as rt
from raden_torch.brdf.model.model import Provenance, RadenBrdf
from raden_torch.brdf.model.table_errors import TableErrors
from raden_torch.brdf.shading.radiance_std import RadianceStd
from raden_torch.errors import InputError
from raden_torch.plots import (
    draw,
    draw_std,
    plot_colour_map,
    plot_in_plane,
    plot_map,
    plot_polar,
    plot_ridge,
    plot_std,
    save_plot,
)
from raden_torch.plots.plot_style import true_colour


@pytest.fixture(scope="module")
def shell() -> rt.BrdfMeasurement:
    """A simulated shell with a standard deviation of 2 % in every channel."""
    m = rt.simulate_specimen("yakogai", step_deg=10).as_rgb()
    return replace(m, std=0.02 * abs(m.values))


@pytest.fixture
def ax() -> Any:
    return Figure().add_subplot()


def at(m: rt.BrdfMeasurement, incidence: float) -> rt.BrdfMeasurement:
    return m.select(m.incidence_deg == incidence)


def test_the_map_has_the_values_of_green_with_units(shell, ax) -> None:
    plot_map(ax, shell, incidence_deg=30)
    (mesh,) = ax.collections
    # receiving runs across, tilt up
    values = at(shell, 30).values[:, 1].reshape(15, 15).T
    np.testing.assert_allclose(mesh.get_array().reshape(15, 15), values)
    assert mesh.get_cmap().name == "viridis"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("receiving r (deg)", "tilt t (deg)")
    assert "reflectance factor" in ax.figure.axes[-1].get_ylabel()


def test_the_colour_map_is_the_display_s_colour(shell, ax) -> None:
    plot_colour_map(ax, shell, incidence_deg=30)
    (mesh,) = ax.collections
    wanted = true_colour(at(shell, 30).values.reshape(15, 15, 3)).swapaxes(0, 1)
    np.testing.assert_allclose(np.asarray(mesh.get_array()).reshape(15, 15, 4), wanted)


def test_the_map_of_std_is_in_percent(shell, ax) -> None:
    plot_std(ax, shell, incidence_deg=30)
    (mesh,) = ax.collections
    np.testing.assert_allclose(mesh.get_array(), 2.0)
    assert mesh.get_cmap().name == "cividis"
    plain = Figure().add_subplot()
    plot_std(plain, replace(shell, std=None))
    assert [text.get_text() for text in plain.texts] == ["no standard deviations are stated"]


def test_bands_are_one_std_wide(shell, ax) -> None:
    plot_in_plane(ax, shell, incidence_deg=30, tilt_deg=10)
    row = at(shell, 30).select(at(shell, 30).tilt_deg == 10)
    for channel, band in enumerate(ax.collections):
        edges = band.get_paths()[0].vertices
        for receiving, value, std in zip(
            row.receiving_deg, row.values[:, channel], row.std[:, channel], strict=True
        ):
            here = edges[edges[:, 0] == receiving][:, 1]
            assert here.min() == pytest.approx(value - std)
            assert here.max() == pytest.approx(value + std)
    assert len(ax.collections) == 3


def test_polar_has_the_light_on_the_left_and_the_mirror_on_the_right(shell) -> None:
    ax: Any = Figure().add_subplot(projection="polar")
    plot_polar(ax, shell, incidence_deg=30)
    lines = {line.get_label(): line for line in ax.lines}
    assert lines["light"].get_xdata()[0] == pytest.approx(-np.deg2rad(30))
    assert lines["mirror r = a"].get_xdata()[0] == pytest.approx(np.deg2rad(30))
    row = at(shell, 30).select(at(shell, 30).tilt_deg == 0)
    np.testing.assert_allclose(np.rad2deg(lines["G"].get_xdata()), row.receiving_deg)
    np.testing.assert_allclose(lines["G"].get_ydata(), row.values[:, 1])
    with pytest.raises(InputError, match="polar"):
        plot_polar(Figure().add_subplot(), shell)


def test_the_ridge_is_what_lies_at_receiving_equal_to_incidence(shell, ax) -> None:
    plot_ridge(ax, shell)
    lines = {line.get_label(): line for line in ax.lines}
    on = shell.select((shell.receiving_deg == shell.incidence_deg) & (shell.tilt_deg == 0))
    np.testing.assert_allclose(lines["R"].get_xdata(), on.incidence_deg)
    np.testing.assert_allclose(lines["R"].get_ydata(), on.values[:, 0])


def test_scattered_readings_are_drawn_as_squares(shell) -> None:
    shift = np.random.default_rng(0).uniform(0, 2, len(shell))
    scattered = replace(shell, incidence_deg=np.clip(shell.incidence_deg + shift, 0, 90))
    drawings: tuple[Callable[..., None], ...] = (plot_map, plot_colour_map, plot_std)
    for plot in drawings:
        ax = Figure().add_subplot()
        plot(ax, scattered, incidence_deg=20)
        assert len(ax.collections[0].get_offsets()) > 50
    ax = Figure().add_subplot()
    plot_ridge(ax, scattered)
    assert ax.lines


@pytest.mark.parametrize("suffix", [".svg", ".pdf", ".png"])
def test_all_of_a_model_with_errors_in_vectors(shell, tmp_path: Path, suffix: str) -> None:
    from raden_torch.brdf.fitting.interpolated_table import make_table
    from raden_torch.brdf.fitting.tabulate import tabulate

    table = tabulate(shell)
    model = RadenBrdf(None, make_table(table, table.values, "trilinear", "diffuse"))
    own = 0.03 * model.runtime_table().detach().abs()
    model.errors = TableErrors(own, torch.zeros(0, *own.shape), 0.01)
    path = tmp_path / f"sheet{suffix}"
    save_plot(draw(model, ["map", "colours", "polar", "ridge", "std", "5"]), path)
    start = {".svg": b"<?xml", ".pdf": b"%PDF", ".png": b"\x89PNG"}[suffix]
    assert path.read_bytes().startswith(start)


def test_the_map_of_a_picture_s_std(shell, tmp_path: Path) -> None:
    image = torch.ones(1, 3, 4, 6)
    image[..., 0] = 0.0
    std = RadianceStd(0.03 * image, 0.04 * image)
    figure = draw_std(image, std, Provenance("yakogai", simulated=True))
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert titles[1:4] == [
        "own errors: median 3 %",
        "systematic errors: median 4 %",
        "together: median 5 %",
    ]
    drawn = figure.axes[3].images[0].get_array()
    assert np.isnan(np.asarray(drawn)[:, 0]).all()
    np.testing.assert_allclose(np.asarray(drawn)[:, 1:], 5.0, rtol=1e-5)
    assert figure.get_suptitle().startswith("simulated specimen: yakogai")
    save_plot(figure, tmp_path / "std.svg")
