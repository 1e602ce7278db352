"""The graphs: what they draw is what was measured, and they say what they cannot draw."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import colour
import cv2
import numpy as np
import pytest
import torch
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from raden_torch import RadenBrdf, fit, simulate_specimen
from raden_torch.brdf.fitting.diffuse_fit import DiffuseParameters, fit_diffuse
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.plots import (
    FIGURES,
    draw,
    plot_diffuse_surface,
    plot_in_plane,
    plot_over_tilt,
    plot_path,
    save_plot,
)
from raden_torch.plots.chromaticity import mirror_paths, uv_of_rgb
from raden_torch.plots.view import view_of


@pytest.fixture(scope="module")
def shell() -> BrdfMeasurement:
    return simulate_specimen("yakogai", step_deg=10)


@pytest.fixture(scope="module")
def model(shell: BrdfMeasurement) -> RadenBrdf:
    return fit(shell).model


@pytest.fixture
def ax() -> Any:
    return Figure().add_subplot()


@pytest.fixture
def surfaces(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Everything that is given to plot_surface: x, y, z and the colours of the facets."""
    given = []
    true_one = Axes3D.plot_surface

    def record(self: Any, x: Any, y: Any, z: Any, **options: Any) -> Any:
        given.append((x, y, z, options["facecolors"]))
        return true_one(self, x, y, z, **options)

    monkeypatch.setattr(Axes3D, "plot_surface", record)
    return given


def line(ax: Any, label: str) -> Any:
    (found,) = [one for one in ax.lines if one.get_label() == label]
    return found


def texts(figure: Figure) -> str:
    written = [figure.get_suptitle()]
    for ax in figure.axes:
        written += [ax.get_title(loc="left"), *(text.get_text() for text in ax.texts)]
    return "\n".join(written)


# -- figure 5 ----------------------------------------------------------------------------------


def test_in_plane_lines_are_the_readings(ax: Any, shell: BrdfMeasurement) -> None:
    plot_in_plane(ax, shell, incidence_deg=22, tilt_deg=9)
    rgb = shell.as_rgb()
    rows = (rgb.incidence_deg == 20) & (rgb.tilt_deg == 10)
    for channel, name in enumerate("RGB"):
        x, y = line(ax, name).get_data()
        np.testing.assert_array_equal(x, rgb.receiving_deg[rows])
        np.testing.assert_array_equal(y, rgb.values[rows, channel])
    assert "incidence 20°, tilt 10°" in ax.get_title(loc="left")
    assert line(ax, "mirror r = a = 20°").get_xdata()[0] == 20
    assert "100" in ax.get_ylabel()
    (strip,) = ax.child_axes
    assert "(deg)" in strip.get_xlabel()


def test_the_strip_is_the_display_transform_of_the_readings(
    ax: Any, shell: BrdfMeasurement
) -> None:
    plot_in_plane(ax, shell)
    rgb = shell.as_rgb()
    linear = rgb.values[(rgb.incidence_deg == 20) & (rgb.tilt_deg == 10)]
    expected = colour.cctf_encoding(np.clip(linear / linear.max(), 0, 1), "sRGB")
    (drawn,) = ax.child_axes[0].collections[0].get_array()
    np.testing.assert_allclose(drawn[:, :3], expected, atol=1e-5)
    assert drawn[:, :3].max() == pytest.approx(1)


def test_gaps_stay_gaps(ax: Any, shell: BrdfMeasurement) -> None:
    hidden = replace(shell, valid=shell.receiving_deg != -20)
    plot_in_plane(ax, hidden)
    x, y = line(ax, "G").get_data()
    assert x[np.isnan(y)].tolist() == [-20]
    opacity = ax.child_axes[0].collections[0].get_array()[0, :, 3]
    assert np.flatnonzero(opacity == 0).tolist() == np.flatnonzero(x == -20).tolist()


def test_a_node_without_readings_is_passed_over(ax: Any, shell: BrdfMeasurement) -> None:
    plot_in_plane(ax, replace(shell, valid=shell.tilt_deg != 10))
    assert "tilt 0°" in ax.get_title(loc="left") or "tilt 20°" in ax.get_title(loc="left")
    assert not np.isnan(line(ax, "G").get_ydata()).any()


def test_a_model_is_drawn_finely_and_beyond_its_table(ax: Any, model: RadenBrdf) -> None:
    plot_in_plane(ax, model, incidence_deg=23, tilt_deg=7)
    x, y = line(ax, "G").get_data()
    np.testing.assert_allclose(x, np.arange(-80, 81))
    at = [torch.deg2rad(torch.tensor([[[v]]], dtype=torch.float64)) for v in (23.0, -31.0, 7.0)]
    with torch.no_grad():
        f = model.fit_form(*at)[1].item()
    assert y[x == -31].item() == pytest.approx(100 * np.pi * f, rel=1e-12)
    assert [text.get_text() for text in ax.texts] == ["outside the table"]
    assert sorted(patch.get_x() for patch in ax.patches) == [-90, 70]


# -- figure 6 ----------------------------------------------------------------------------------


def diffuse_formula(shell: BrdfMeasurement, a: float, r: float, t: Any) -> Any:
    """Eq. (6) as a reflectance factor, with the parameters of the fit to the readings: green."""
    rgb = shell.as_rgb()
    angles = (np.deg2rad(x) for x in (rgb.incidence_deg, rgb.receiving_deg, rgb.tilt_deg))
    found = fit_diffuse(tuple(angles), rgb.values / (100 * np.pi))
    a, r, t = np.deg2rad(a), np.deg2rad(r), np.deg2rad(t)
    f_r = found.scale[1] * np.cos(t) * np.cos(r) * (1 - np.cos(a)) ** found.exponent[1]
    return 100 * np.pi * f_r


def test_over_tilt_data_and_fit(ax: Any, shell: BrdfMeasurement) -> None:
    plot_over_tilt(ax, shell)
    rgb = shell.as_rgb()
    rows = (rgb.incidence_deg == 20) & (rgb.receiving_deg == 60)
    np.testing.assert_array_equal(line(ax, "G").get_ydata(), rgb.values[rows, 1])
    scale = diffuse_formula(shell, 20, 60, 0.0)
    curve = line(ax, f"fit {scale:.3g} cos t")
    t, y = curve.get_data()
    np.testing.assert_allclose(y, scale * np.cos(np.deg2rad(t)), rtol=1e-12)
    assert (curve.get_linestyle(), line(ax, "G").get_linestyle()) == ("--", "-")
    assert ax.get_xlabel() == "tilt t (deg)"


def test_the_fit_of_a_model_is_its_own_diffuse_part(ax: Any, model: RadenBrdf) -> None:
    brighter = RadenBrdf(model.diffuse, model.table, diffuse_gain=2.0)
    plot_over_tilt(ax, brighter, incidence_deg=40, receiving_deg=-10)
    assert model.diffuse is not None
    scale, n = model.diffuse.scale[0].item(), model.diffuse.exponent[0].item()
    a, r = np.deg2rad(40), np.deg2rad(-10)
    expected = 2 * 100 * np.pi * scale * np.cos(r) * (1 - np.cos(a)) ** n
    red = next(one for one in ax.lines if one.get_linestyle() == "--")
    assert red.get_ydata().max() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("incidence", "receiving"), [(20, 60), (30, 70), (40, 0), (70, 30)])
def test_figure_6_keeps_away_from_the_ridge(
    ax: Any, shell: BrdfMeasurement, incidence: float, receiving: float
) -> None:
    plot_over_tilt(ax, shell, incidence_deg=incidence)
    assert f"incidence {incidence}°, receiving {receiving}°" in ax.get_title(loc="left")


def test_the_diffuse_part_may_be_set_by_hand(
    shell: BrdfMeasurement, surfaces: list[tuple[Any, ...]]
) -> None:
    by_hand = DiffuseParameters((0.1, 0.2, 0.3), (1.0, 2.0, 0.5))
    over_tilt, _ = draw(shell, ("6", "8"), surface_tilt_deg=50, diffuse=by_hand).axes
    drawn = [one.get_ydata().max() for one in over_tilt.lines if one.get_linestyle() == "--"]
    a, r = np.deg2rad(20), np.deg2rad(60)
    expected = [
        100 * np.pi * scale * np.cos(r) * (1 - np.cos(a)) ** n
        for scale, n in zip(by_hand.scale, by_hand.exponent, strict=True)
    ]
    np.testing.assert_allclose(drawn, expected, rtol=1e-12)
    ((r, a, height, _),) = surfaces
    a, r, t = np.deg2rad(a), np.deg2rad(r), np.deg2rad(50)
    expected = 100 * np.pi * 0.2 * np.cos(t) * np.cos(r) * (1 - np.cos(a)) ** 2
    np.testing.assert_allclose(height, expected, rtol=1e-12, atol=1e-12)


# -- figures 7, 8 and 9 ------------------------------------------------------------------------


def test_surface_and_fit_are_comparable(
    shell: BrdfMeasurement, surfaces: list[tuple[Any, ...]]
) -> None:
    data, formula = draw(shell, ("7", "8"), surface_tilt_deg=52).axes
    grid = shell.as_rgb().grid()
    heights = grid.values[:, :, grid.tilt_deg == 50, 1][:, :, 0]
    (x, y, z, colours), (_, _, z_fit, _) = surfaces
    np.testing.assert_array_equal(z, heights)
    np.testing.assert_array_equal(x[0], grid.receiving_deg)
    np.testing.assert_array_equal(y[:, 0], grid.incidence_deg)
    np.testing.assert_allclose(z_fit, diffuse_formula(shell, y, x, 50.0), rtol=1e-12, atol=1e-12)
    assert colours.shape == (7, 14, 4)
    for limits in ("get_xlim", "get_ylim", "get_zlim"):
        assert getattr(data, limits)() == getattr(formula, limits)()
    assert "(deg)" in data.get_xlabel()
    assert "diffuser = 100" in data.get_zlabel()


def test_specular_surface_is_total_minus_diffuse(
    shell: BrdfMeasurement, surfaces: list[tuple[Any, ...]]
) -> None:
    draw(shell, ("9",))
    ((r, t, z, colours),) = surfaces
    grid = shell.as_rgb().grid()
    total = grid.values[grid.incidence_deg == 20][0]
    np.testing.assert_allclose(z, total[..., 1] - diffuse_formula(shell, 20, r, t), rtol=1e-12)
    peaks = t[0][z[r[:, 0] == 20][0] > 0.9 * z.max()]
    assert peaks.tolist() == [-10, 10]
    # the two peaks are one colour: a facet takes the mean of its corners, not one corner
    np.testing.assert_allclose(colours[:, :, :3], colours[:, ::-1, :3], atol=1e-6)


def test_surfaces_need_axes_in_3d(ax: Any, shell: BrdfMeasurement) -> None:
    with pytest.raises(InputError, match="projection"):
        plot_diffuse_surface(ax, shell)


# -- the path ----------------------------------------------------------------------------------


def test_path_points_are_those_of_colour_science(ax: Any, shell: BrdfMeasurement) -> None:
    plot_path(ax, shell)
    flat, peak = (collection.get_offsets() for collection in ax.collections)
    for points, tilt in ((flat, 0), (peak, -10)):
        rows = (shell.incidence_deg == shell.receiving_deg) & (shell.tilt_deg == tilt)
        xy = colour.XYZ_to_xy(shell.values[rows])
        np.testing.assert_allclose(points, colour.xy_to_Luv_uv(xy), atol=1e-10)
    written = {text.get_text() for text in ax.texts}
    assert {"0°", "70°"} <= written
    labels = ax.get_legend_handles_labels()[1]
    assert {"spectral locus", "sRGB gamut", "white (D65)", "tilt 0°"} < set(labels)
    assert any("−10° (brightest)" in label for label in labels)
    (white,) = np.transpose(line(ax, "white (D65)").get_data())
    np.testing.assert_allclose(white, [0.1978, 0.4683], atol=1e-4)


def test_path_of_a_model_marks_whole_tens(ax: Any, model: RadenBrdf) -> None:
    plot_path(ax, model)
    assert [len(points.get_offsets()) for points in ax.collections] == [8, 8]
    assert len(ax.lines[-1].get_xdata()) == 71


def test_no_colour_in_the_dark(ax: Any, shell: BrdfMeasurement) -> None:
    factor = np.select([shell.incidence_deg > 50, shell.incidence_deg == 30], [-1.0, 0.0], 1.0)
    dark = replace(shell, values=shell.values * factor[:, None])
    for path in mirror_paths(view_of(dark), 20.0):
        assert path.incidence_deg[np.isnan(path.uv[:, 0])].tolist() == [30, 60, 70]
    plot_path(ax, dark)
    assert [len(points.get_offsets()) for points in ax.collections] == [5, 5]
    black = replace(shell, values=0 * shell.values)
    assert "needs a positive luminance" in texts(draw(black))


def test_uv_of_the_primaries() -> None:
    uv, luminance = uv_of_rgb(np.eye(3))
    expected = colour.xy_to_Luv_uv([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])
    np.testing.assert_allclose(uv, expected, atol=2e-4)  # the standard's matrix has four digits
    np.testing.assert_allclose(luminance, [0.2126, 0.7152, 0.0722], atol=1e-4)


# -- what is not there, and what must be said --------------------------------------------------


def test_one_plane_says_what_is_missing(shell: BrdfMeasurement) -> None:
    figure = draw(shell.select(shell.tilt_deg == 0))
    written = {
        ax.get_title(loc="left")[:6]: "".join(text.get_text() for text in ax.texts)
        for ax in figure.axes
    }
    assert written["Fig. 6"] == written["Fig. 9"] == "needs several tilts"
    assert "needs" not in written["Fig. 5"] + written["Fig. 7"] + written["Fig. 8"]
    one = BrdfMeasurement([20.0], [20.0], [0.0], [[1.0, 2.0, 3.0]])
    assert "needs several receiving angles and incidences" in texts(draw(one))


def test_scattered_readings_become_dots(ax: Any) -> None:
    angles = np.random.default_rng(0).uniform([0, -70, -70], [70, 70, 70], (3000, 3))
    readings = simulate_specimen("yakogai", geometries_deg=angles)
    plot_in_plane(ax, readings)
    a, r, t = angles.T
    expected = np.sort(r[(abs(a - 20) <= 2.5) & (abs(t - 10) <= 2.5)])
    assert len(expected) > 3
    assert line(ax, "G").get_linestyle() == "None"
    np.testing.assert_allclose(np.sort(line(ax, "G").get_xdata()), expected)
    assert "≈" in ax.get_title(loc="left")
    assert "scattered readings" in texts(draw(readings))


def test_one_band_is_grey_and_has_no_path(shell: BrdfMeasurement) -> None:
    laser = replace(shell, values=shell.values[:, 1:2], channels=("650nm",))
    figure = draw(laser)
    assert "one band has no colour" in texts(figure)
    first = figure.axes[0]
    np.testing.assert_array_equal(
        line(first, "650 nm").get_ydata(),
        laser.values[(laser.incidence_deg == 20) & (laser.tilt_deg == 10), 0],
    )
    assert "true colour" not in first.child_axes[0].get_xlabel()
    narrow = replace(shell, values=shell.values[:, :2], channels=("500nm", "560nm"))
    assert "these bands make no colour" in texts(draw(narrow, ("5", "path")))


def test_parts_that_a_model_lacks(model: RadenBrdf) -> None:
    assert "no diffuse part" in texts(draw(RadenBrdf(None, model.table)))
    assert "simulated" not in texts(draw(RadenBrdf(model.diffuse, None)))


@pytest.mark.parametrize("figure", FIGURES)
def test_every_sheet_says_that_it_is_simulated(shell: BrdfMeasurement, figure: str) -> None:
    assert "simulated specimen: yakogai" in texts(draw(shell, (figure,)))


def test_simulated_model_and_measured_sample(shell: BrdfMeasurement, model: RadenBrdf) -> None:
    assert "simulated specimen: yakogai\nmodel" in texts(draw(model, ("5",)))
    measured = replace(shell, metadata=Metadata("a shell"))
    assert draw(measured, ("5",)).get_suptitle() == "a shell\nmeasurement"


def test_any_name_can_be_drawn(shell: BrdfMeasurement, tmp_path: Path) -> None:
    name = "夜光貝 🐚 $x_1 & 50 % \u0007" + " a very long name" * 20
    figure = draw(replace(shell, metadata=Metadata(name)), ("5",))
    save_plot(figure, tmp_path / "plot.png")
    assert "$x_1 & 50 %" in figure.get_suptitle()
    assert len(figure.get_suptitle().splitlines()) == 3


# -- files and errors --------------------------------------------------------------------------


@pytest.mark.parametrize("figures", [FIGURES, ("5", "9"), ("path",)])
def test_png_has_the_size_of_the_sheet(
    shell: BrdfMeasurement, tmp_path: Path, figures: tuple[str, ...]
) -> None:
    figure = draw(shell, figures)
    save_plot(figure, tmp_path / "plot.png")
    picture = cv2.imread(str(tmp_path / "plot.png"))
    assert picture.shape[:2] == tuple(np.rint(figure.get_size_inches()[::-1] * 120))
    assert picture.min() < 50
    assert (picture == 255).mean() > 0.5


@pytest.mark.parametrize(("suffix", "start"), [(".svg", b"<?xml"), (".PDF", b"%PDF")])
def test_vector_files(shell: BrdfMeasurement, tmp_path: Path, suffix: str, start: bytes) -> None:
    save_plot(draw(shell, ("5", "7", "path")), tmp_path / f"plot{suffix}")
    assert (tmp_path / f"plot{suffix}").read_bytes().startswith(start)


BAD: dict[str, tuple[Callable[[BrdfMeasurement], Any], str]] = {
    "suffix": (lambda m: save_plot(Figure(), "plot.bmp"), ".png, .svg, .pdf"),
    "folder": (lambda m: save_plot(Figure(), "none/plot.png"), "expected an existing folder"),
    "figure": (
        lambda m: draw(m, ("5", "10")),
        "figure: expected one of 5, 6, 7, 8, 9, path, map, colours, polar, ridge, std, got '10'",
    ),
    "figures: expected some of 5, 6, 7, 8, 9, path, map, colours, polar, ridge, std, got none": (
        lambda m: draw(m, ()),
        "figures: expected some of 5, 6, 7, 8, 9, path, map, colours, polar, ridge, std, got none",
    ),
    "incidence": (
        lambda m: draw(m, incidence_deg=-1),
        "incidence_deg: expected 0…90 degrees, got -1",
    ),
    "tilt": (
        lambda m: draw(m, surface_tilt_deg=91),
        "surface_tilt_deg: expected -90…90 degrees, got 91",
    ),
    "not a number": (
        lambda m: draw(m, receiving_deg=float("nan")),
        "receiving_deg: expected -90…90 degrees, got nan",
    ),
    "no reading": (
        lambda m: draw(replace(m, valid=m.valid & False)),
        "expected a measurement with a valid reading, got none",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line(
    shell: BrdfMeasurement, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    work, message = BAD[name]
    with pytest.raises(InputError) as caught:
        work(shell)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_no_pyplot_and_no_open_figures() -> None:
    """colour-science imports pyplot for itself, so it is kept away: RGB readings, no path."""
    program = """
import sys
import numpy as np
from raden_torch.measurement import BrdfMeasurement
from raden_torch.plots import draw
a, r, t = (x.ravel() for x in np.meshgrid([0, 20.0], [-20.0, 0, 20], [0, 10.0], indexing="ij"))
m = BrdfMeasurement(a, r, t, np.stack([a + 1, r + 30, t + 5], 1), ("R", "G", "B"))
draw(m, ("5", "6", "7", "8", "9"))
assert "matplotlib.pyplot" not in sys.modules, "pyplot"
draw(m)
from matplotlib import pyplot
assert pyplot.get_fignums() == []
"""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
