"""One sheet with the graphs asked for, and its file."""

from __future__ import annotations

import io
import os
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from raden_torch.brdf.files.display import check_picture_path
from raden_torch.brdf.fitting.diffuse_fit import DiffuseParameters
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.errors import InputError
from raden_torch.files import written_beside
from raden_torch.measurement import BrdfMeasurement
from raden_torch.plots.chromaticity import plot_path
from raden_torch.plots.cuts import ANGLE_LIMITS_DEG
from raden_torch.plots.lines import plot_in_plane, plot_over_tilt, plot_ridge
from raden_torch.plots.maps import plot_colour_map, plot_map, plot_std
from raden_torch.plots.plot_style import INK, TEXT, families, printable
from raden_torch.plots.polar import plot_polar
from raden_torch.plots.surfaces import plot_diffuse_surface, plot_specular_surface
from raden_torch.plots.view import View, view_of

FIGURES = ("5", "6", "7", "8", "9", "path", "map", "colours", "polar", "ridge", "std")
"""The paper's figures 5 to 9, the iridescence path, maps over receiving × tilt, the polar curve,
the mirror ridge, and the map of standard deviations."""
PLOT_SUFFIXES = (".png", ".svg", ".pdf")

_PROJECTIONS = {"7": "3d", "8": "3d", "9": "3d", "polar": "polar"}
_MAPS = {"map": plot_map, "colours": plot_colour_map, "std": plot_std}
_COLUMNS = 2
_PANEL_INCHES = (6.4, 4.5)
_HEAD_INCHES = 0.6
_DPI = 120
_LETTERS_PER_INCH = 10.5  # of the head


def draw(
    source: BrdfMeasurement | RadenBrdf,
    figures: Sequence[str] | None = None,
    *,
    incidence_deg: float = 20.0,
    tilt_deg: float = 10.0,
    surface_tilt_deg: float = 55.0,
    receiving_deg: float | None = None,
    diffuse: DiffuseParameters | None = None,
) -> Figure:
    """One sheet with the graphs asked for, in their order.

    Args:
        source: a measurement (its nodes nearest to the angles are drawn, and named) or a model.
        figures: of `FIGURES`; all where None, but for "std" of what states no errors.
        incidence_deg: held in figures 5, 6 and 9, the maps and the polar curve; the path's tilt is
            the brightest there.
        tilt_deg: held in figure 5.
        surface_tilt_deg: held in figures 7 and 8.
        receiving_deg: held in figure 6; where None, 40° away from the mirror.
        diffuse: S and n set by hand, for figures 6, 8 and 9; where None, the fit's or the model's.

    Raises:
        InputError: an unknown figure, an angle out of range, or no valid reading.
    """
    wanted = FIGURES if figures is None else _check_figures(figures)
    at = {
        "incidence_deg": incidence_deg,
        "tilt_deg": tilt_deg,
        "surface_tilt_deg": surface_tilt_deg,
    }
    for name, angle in (*at.items(), ("receiving_deg", receiving_deg)):
        if angle is not None:
            _check_angle(name, angle)
    view = view_of(source)
    if diffuse is not None:
        view = replace(view, by_hand=diffuse)
    if figures is None and not view.has_std:
        wanted = tuple(name for name in wanted if name != "std")
    figure, axes = _empty_sheet(wanted)
    for name, ax in zip(wanted, axes, strict=True):
        _draw_panel(name, ax, view, at, receiving_deg)
    _write_head(figure, view)
    return figure


def save_plot(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a sheet as PNG, SVG or PDF, by the suffix.

    Raises:
        InputError: another suffix, or a folder that does not exist.
    """
    check_plot_path(path)
    drawn = io.BytesIO()  # matplotlib leaves a file open that it cannot write
    figure.savefig(drawn, dpi=_DPI, format=Path(path).suffix[1:].lower())
    with written_beside(path) as temporary:
        temporary.write_bytes(drawn.getvalue())


def check_plot_path(path: str | os.PathLike[str]) -> None:
    """Raise InputError where a sheet could not be written, so before the work is done."""
    check_picture_path(path, PLOT_SUFFIXES)


def _draw_panel(
    name: str, ax: Any, view: View, at: dict[str, float], receiving_deg: float | None
) -> None:
    incidence_deg, surface_tilt_deg = at["incidence_deg"], at["surface_tilt_deg"]
    if name == "5":
        plot_in_plane(ax, view, incidence_deg=incidence_deg, tilt_deg=at["tilt_deg"])
    elif name == "6":
        plot_over_tilt(ax, view, incidence_deg=incidence_deg, receiving_deg=receiving_deg)
    elif name in ("7", "8"):
        plot_diffuse_surface(ax, view, tilt_deg=surface_tilt_deg, fit=name == "8")
    elif name == "9":
        plot_specular_surface(ax, view, incidence_deg=incidence_deg)
    elif name == "path":
        plot_path(ax, view, incidence_deg=incidence_deg)
    elif name == "polar":
        plot_polar(ax, view, incidence_deg=incidence_deg)
    elif name == "ridge":
        plot_ridge(ax, view)
    else:
        _MAPS[name](ax, view, incidence_deg=incidence_deg)


def _check_figures(figures: Sequence[str]) -> tuple[str, ...]:
    wanted = (figures,) if isinstance(figures, str) else tuple(map(str, figures))
    for name in wanted:
        if name not in FIGURES:
            raise InputError(f"plot: figure: expected one of {', '.join(FIGURES)}, got {name!r}")
    if not wanted:
        raise InputError(f"plot: figures: expected some of {', '.join(FIGURES)}, got none")
    return wanted


def _check_angle(name: str, angle: float) -> None:
    of = next((of for of in ANGLE_LIMITS_DEG if of in name), "")
    low, high = ANGLE_LIMITS_DEG[of]
    if not low <= angle <= high:
        raise InputError(f"plot: {name}: expected {low:g}…{high:g} degrees, got {angle:g}")


def _empty_sheet(wanted: tuple[str, ...]) -> tuple[Figure, list[Any]]:
    """A figure on the Agg canvas, with ordinary, 3-D or polar axes a panel."""
    columns = min(_COLUMNS, len(wanted))
    rows = -(-len(wanted) // columns)
    width, height = columns * _PANEL_INCHES[0], rows * _PANEL_INCHES[1] + _HEAD_INCHES
    figure = Figure(figsize=(width, height), dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = [
        figure.add_subplot(rows, columns, i + 1, projection=_PROJECTIONS.get(name))
        for i, name in enumerate(wanted)
    ]
    return figure, axes


def _write_head(figure: Figure, view: View) -> None:
    """The sample's name, what was drawn of it, and that it is simulated where it is."""
    kind = "model" if view.is_model else "measurement"
    head = f"simulated specimen: {view.sample}" if view.simulated else view.sample
    width = int(_LETTERS_PER_INCH * figure.get_figwidth())
    lines = textwrap.wrap(head, width, max_lines=2, placeholder=" …")
    about = " · ".join(filter(None, (kind, view.note)))
    figure.suptitle(
        "\n".join((*map(printable, lines), about)),
        family=families(head),
        parse_math=False,
        fontsize=TEXT + 2,
        color="#a3271f" if view.simulated else INK,
    )
