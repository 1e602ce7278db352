"""Reflectance over receiving × tilt at one incidence: in G, in true colour, and its uncertainty."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize

from raden_torch.arrays import Floats
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.measurement import BrdfMeasurement
from raden_torch.plots.cuts import Cut
from raden_torch.plots.plot_style import (
    FACTOR_LABEL,
    SMALL,
    TEXT,
    UNMEASURED,
    brightest,
    cell_edges,
    curves,
    finish,
    or_say_missing,
    say_missing,
    true_colour,
)
from raden_torch.plots.view import View, view_of

_WIDE = 30.0
"""Largest over median value above which the scale is logarithmic."""
_DECADES = 3.0
_TOP = 0.98
"""Quantile where the colours of the uncertainty end."""

Source = BrdfMeasurement | RadenBrdf | View


def plot_map(ax: Axes, source: Source, *, incidence_deg: float = 20.0) -> None:
    """The reflectance factor in G (or the one band), in viridis; logarithmic where it spans much.

    Args:
        incidence_deg: held, in degrees; a measurement takes its nearest node.
    """
    view, cut = _cut(ax, source, "Map", incidence_deg)
    if cut is None:
        return
    values = cut.values[..., view.shown]
    most = brightest(cut.values[..., view.shown, None])
    norm = Normalize(0.0, most)
    middle = float(np.nanmedian(values))
    if most > _WIDE * max(middle, 1e-9):
        least = most / 10**_DECADES
        norm = LogNorm(least, most)
        values = np.where(np.isnan(values), np.nan, np.maximum(values, least))
    drawn = _draw(ax, cut, values, cmap="viridis", norm=norm)
    _bar(ax, drawn, f"{curves(view)[view.shown].name}, {FACTOR_LABEL}")
    _frame(ax, f"Map, {cut.held}")


def plot_colour_map(ax: Axes, source: Source, *, incidence_deg: float = 20.0) -> None:
    """The same in true colour, exposed so that the largest value is white."""
    view, cut = _cut(ax, source, "True colour", incidence_deg)
    if cut is None:
        return
    colours = true_colour(cut.values)
    if cut.joined:
        x, y = _edges(cut)
        ax.pcolormesh(x, y, colours.swapaxes(0, 1), rasterized=True)
    else:
        ax.scatter(cut.deg["receiving"], cut.deg["tilt"], c=colours, s=26, marker="s", lw=0)
    shown = "Brightness" if view.colourless else "True colour"
    _frame(ax, f"{shown}, {cut.held}; exposed to the maximum")


def plot_std(ax: Axes, source: Source, *, incidence_deg: float = 20.0) -> None:
    """The standard deviation in G over the value, in percent, in cividis: all errors but the
    scale's, which is the same everywhere."""
    title = "Standard deviation"
    view, cut = _cut(ax, source, title, incidence_deg)
    if cut is None:
        return
    if cut.std is None:
        say_missing(ax, title, "no standard deviations are stated")
        return
    level = cut.values[..., view.shown]
    positive = level > 1e-6 * brightest(level[..., None])
    share = np.where(
        positive, 100 * cut.std[..., view.shown] / np.where(positive, level, 1), np.nan
    )
    if np.isnan(share).all():
        say_missing(ax, title, "no standard deviations are stated at this incidence")
        return
    top = max(float(np.nanquantile(share, _TOP)), 1e-6)
    drawn = _draw(ax, cut, share, cmap="cividis", norm=Normalize(0.0, top))
    name = curves(view)[view.shown].name
    _bar(ax, drawn, f"std of {name} (k = 1), % of the value", extend="max")
    _frame(ax, f"{title}, {cut.held}; without the scale's")


def _edges(cut: Cut) -> tuple[Floats, Floats]:
    """Of the cells around the nodes, along receiving and tilt."""
    return cell_edges(cut.deg["receiving"][:, 0]), cell_edges(cut.deg["tilt"][0])


def _cut(ax: Axes, source: Source, title: str, incidence_deg: float) -> tuple[View, Cut | None]:
    view, held = view_of(source), {"incidence": incidence_deg}
    return view, or_say_missing(ax, title, lambda: view.samples.cut(("receiving", "tilt"), held))


def _draw(ax: Axes, cut: Cut, values: Floats, **style: Any) -> Any:
    """Cells of a grid, or squares where the readings are scattered; what is not known is grey."""
    ax.set_facecolor(UNMEASURED)
    if not cut.joined:
        x, y = cut.deg["receiving"], cut.deg["tilt"]
        return ax.scatter(x, y, c=values, s=26, marker="s", lw=0, **style)
    x, y = _edges(cut)
    return ax.pcolormesh(x, y, np.ma.masked_invalid(values).T, rasterized=True, **style)


def _bar(ax: Axes, drawn: Any, label: str, extend: str = "neither") -> None:
    bar = ax.figure.colorbar(drawn, ax=ax, shrink=0.9, pad=0.02, extend=extend)
    bar.set_label(label, fontsize=SMALL)
    bar.ax.tick_params(labelsize=SMALL)


def _frame(ax: Axes, title: str) -> None:
    finish(ax, title, "receiving r (deg)", "tilt t (deg)")
    ax.set_facecolor(UNMEASURED)
    ax.set_aspect("equal")
    ax.grid(False)
    ax.xaxis.label.set_fontsize(TEXT)
