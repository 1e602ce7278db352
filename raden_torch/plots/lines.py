"""Reflectance along one angle: the paper's figures 5 and 6, and the mirror ridge."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from raden_torch.arrays import Floats
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.measurement import BrdfMeasurement
from raden_torch.plots.cuts import OUTSIDE_DEG, SLAB_DEG, Cut
from raden_torch.plots.plot_style import (
    FACTOR_LABEL,
    FAINT,
    INK,
    SMALL,
    TEXT,
    UNMEASURED,
    Curve,
    cell_edges,
    curves,
    finish,
    or_say_missing,
    say_missing,
    true_colour,
)
from raden_torch.plots.view import View, view_of

AWAY_DEG = 40.0
"""Figure 6 looks this far beyond the mirror direction, where nothing says otherwise."""


def plot_in_plane(
    ax: Axes,
    source: BrdfMeasurement | RadenBrdf | View,
    *,
    incidence_deg: float = 20.0,
    tilt_deg: float = 10.0,
) -> None:
    """Figure 5: R, G and B over the receiving angle, with the mirror angle and true colour.

    Args:
        ax: ordinary axes; the strip of true colour is drawn beneath them.
        incidence_deg, tilt_deg: the held angles in degrees; a measurement takes its nearest node.
    """
    view, title = view_of(source), "Fig. 5: in-plane slice"
    held = {"incidence": incidence_deg, "tilt": tilt_deg}
    cut = or_say_missing(ax, title, lambda: view.samples.cut(("receiving",), held))
    if cut is None:
        return
    angle = cut.deg["receiving"]
    mirror = float(np.mean(cut.deg["incidence"]))
    _draw_data(ax, view, angle, cut)
    ax.axvline(
        mirror, color=INK, linewidth=1, linestyle=(0, (1, 2)), label=f"mirror r = a = {mirror:.3g}°"
    )
    _mark_box(ax, view, "receiving")
    finish(ax, f"{title}, {cut.held}", "", FACTOR_LABEL)
    ax.tick_params(labelbottom=False)
    ax.set_xlim(*cell_edges(angle)[[0, -1]])
    _from_zero(ax, cut)
    say_band(ax, cut)
    # finding the best place among many loose dots is slow, and Matplotlib warns of it
    ax.legend(fontsize=SMALL, frameon=False, loc="best" if cut.joined else "upper right")
    _strip(ax, view, cut)


def plot_over_tilt(
    ax: Axes,
    source: BrdfMeasurement | RadenBrdf | View,
    *,
    incidence_deg: float = 20.0,
    receiving_deg: float | None = None,
) -> None:
    """Figure 6: reflectance over the tilt, away from the mirror ridge, and its fit S_T cos t.

    Args:
        incidence_deg, receiving_deg: the held angles in degrees; a measurement takes its nearest
            node. Where receiving is None it lies 40° beyond the mirror, or before it.
    """
    view, title = view_of(source), "Fig. 6: over the tilt"
    if receiving_deg is None:
        beyond = incidence_deg + AWAY_DEG
        most = view.samples.limits("receiving")[1]
        receiving_deg = beyond if beyond <= most else incidence_deg - AWAY_DEG
    held = {"incidence": incidence_deg, "receiving": receiving_deg}
    cut = or_say_missing(ax, title, lambda: view.samples.cut(("tilt",), held))
    if cut is None:
        return
    tilt = cut.deg["tilt"]
    _draw_data(ax, view, tilt, cut)
    _draw_tilt_fit(ax, view, cut)
    _mark_box(ax, view, "tilt")
    finish(ax, f"{title}, {cut.held}", "tilt t (deg)", FACTOR_LABEL)
    ax.set_xlim(*cell_edges(tilt)[[0, -1]])
    low, high = ax.get_ylim()
    ax.set_ylim(top=high + 0.3 * (high - low))  # room for the legend
    _from_zero(ax, cut)
    say_band(ax, cut)
    ax.legend(fontsize=SMALL, frameon=False, loc="upper center", ncols=2)


def plot_ridge(ax: Axes, source: BrdfMeasurement | RadenBrdf | View) -> None:
    """R, G and B along the mirror ridge, receiving = incidence, at the tilt nearest to 0, with true
    colour; the dashed line is the brightest tilt's G (or the one band's)."""
    view, title = view_of(source), "Ridge: receiving = incidence"
    ridge = or_say_missing(ax, title, view.samples.mirror)
    if ridge is None:
        return
    tilt = ridge.deg["tilt"]
    if ridge.joined:
        lines = np.flatnonzero((~np.isnan(ridge.values[..., 0])).sum(0) >= 2)
        if not len(lines):
            say_missing(ax, title, "needs two valid readings side by side")
            return
        at = lines[np.argmin(abs(tilt[0, lines]))]
        cut = ridge.along(at)
        _draw_data(ax, view, cut.deg["incidence"], cut)
        peak = lines[np.nanargmax(np.nanmax(ridge.values[:, lines, view.shown], axis=0))]
        if peak != at:
            most = ridge.along(peak)
            ax.plot(
                most.deg["incidence"],
                most.values[..., view.shown],
                color=INK,
                linewidth=1,
                linestyle="--",
                label=f"{curves(view)[view.shown].name} at tilt {tilt[0, peak]:g}°".replace(
                    "-", "−"
                ),
            )
        at_tilt = f"tilt {tilt[0, at]:g}°".replace("-", "−")
    else:
        near = abs(tilt) <= SLAB_DEG
        if near.sum() < 2:
            say_missing(ax, title, f"needs readings within {SLAB_DEG:g}° of tilt 0")
            return
        cut = ridge.along(near)
        _draw_data(ax, view, cut.deg["incidence"], cut)
        at_tilt = f"tilt within {SLAB_DEG:g}° of 0°"
    finish(ax, f"{title}, {at_tilt}", "", FACTOR_LABEL)
    ax.tick_params(labelbottom=False)
    ax.set_xlim(*cell_edges(cut.deg["incidence"])[[0, -1]])
    _from_zero(ax, cut)
    say_band(ax, cut)
    ax.legend(fontsize=SMALL, frameon=False, loc="best" if cut.joined else "upper right")
    _strip(ax, view, cut, "incidence", "a = r")


def _draw_data(ax: Axes, view: View, x: Floats, cut: Cut) -> None:
    """Lines for a model, dots joined by thin lines for nodes, dots alone for scattered readings."""
    for curve in curves(view):
        draw_band(ax, x, cut, curve)
        ax.plot(
            x,
            cut.values[..., curve.channel],
            color=curve.colour,
            marker="" if view.is_model else curve.marker,
            markersize=3.2,
            linestyle="-" if cut.joined else "none",
            linewidth=1.6 if view.is_model else 0.9,
            label=curve.name,
        )


def draw_band(ax: Axes, x: Floats, cut: Cut, curve: Curve) -> None:
    """± 1 standard deviation, all errors but the scale's: a band, or bars of scattered readings."""
    if cut.std is None:
        return
    value, std = cut.values[..., curve.channel], cut.std[..., curve.channel]
    if cut.joined:
        ax.fill_between(x, value - std, value + std, color=curve.colour, alpha=0.22, linewidth=0)
    else:
        ax.errorbar(x, value, std, fmt="none", ecolor=curve.colour, elinewidth=0.7, alpha=0.6)


def say_band(ax: Axes, cut: Cut) -> None:
    """What the bands are, where there are some."""
    if cut.std is not None:
        what = "bands" if cut.joined else "bars"
        text = f"{what}: ± 1 std, without the scale's"
        ax.text(
            0.99, 0.02, text, transform=ax.transAxes, ha="right", fontsize=SMALL - 1, color="0.4"
        )


def _draw_tilt_fit(ax: Axes, view: View, cut: Cut) -> None:
    tilt = np.linspace(cut.deg["tilt"].min(), cut.deg["tilt"].max(), 181)
    deg = {"tilt": np.append(tilt, 0.0)}  # T(0) = S_T
    for name in ("incidence", "receiving"):
        deg[name] = np.full_like(deg["tilt"], cut.deg[name].mean())
    fit = view.diffuse_factors(deg)
    if fit is None:
        return
    for curve in curves(view):
        *line, scale = fit[:, curve.channel]
        label = f"fit {scale:.3g} cos t"
        ax.plot(tilt, line, color=curve.colour, linewidth=1.5, linestyle="--", label=label)


def _from_zero(ax: Axes, cut: Cut) -> None:
    """The height starts at 0 where no value is negative."""
    if np.nanmin(cut.values) >= 0:
        ax.set_ylim(bottom=0.0)


def _mark_box(ax: Axes, view: View, angle: str) -> None:
    """Shade what lies outside a model's table, and say so."""
    if not isinstance(view.source, RadenBrdf) or view.source.table is None:
        return
    low, high = view.samples.limits(angle)
    for beyond in ((-90.0, low), (high, 90.0)):
        ax.axvspan(*beyond, color="0.94", linewidth=0, zorder=0)
    ax.text(
        high + OUTSIDE_DEG / 2,
        0.5,
        "outside the table",
        transform=ax.get_xaxis_transform(),
        rotation=90,
        ha="center",
        va="center",
        fontsize=SMALL,
        color="0.45",
        clip_on=True,
    )


def _strip(ax: Axes, view: View, cut: Cut, over: str = "receiving", symbol: str = "r") -> None:
    """True colour along an axis, exposed so that the largest value is white."""
    strip = ax.inset_axes((0, -0.13, 1, 0.09))
    strip.sharex(ax)
    order = np.argsort(cut.deg[over])
    strip.set_facecolor(UNMEASURED)
    edges = cell_edges(cut.deg[over])
    strip.pcolormesh(edges, [0, 1], true_colour(cut.values[order])[None])
    strip.set_yticks([])
    strip.tick_params(labelsize=SMALL)
    strip.spines[:].set_color(FAINT)
    shown = "brightness" if view.colourless else "true colour"
    strip.set_xlabel(
        f"{over} {symbol} (deg); strip: {shown}, exposed to the maximum", fontsize=TEXT
    )
