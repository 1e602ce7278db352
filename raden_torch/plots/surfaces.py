"""Reflectance over two angles, as surfaces: the paper's figures 7, 8 and 9."""

from __future__ import annotations

from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.plots.cuts import Cut
from raden_torch.plots.plot_style import (
    INK,
    SMALL,
    TEXT,
    brightest,
    curves,
    or_say_missing,
    say_missing,
    true_colour,
)
from raden_torch.plots.view import View, view_of

_SYMBOLS = {"incidence": "a", "receiving": "r", "tilt": "t"}
_LINE = (0.1, 0.1, 0.1, 0.35)


def plot_diffuse_surface(
    ax: Any,
    source: BrdfMeasurement | RadenBrdf | View,
    *,
    tilt_deg: float = 55.0,
    fit: bool = False,
) -> None:
    """Figure 7: reflectance over receiving × incidence at a tilt; figure 8: its diffuse fit.

    Both have the same axes, limits and exposure, so that they can be compared side by side.

    Args:
        ax: axes with `projection="3d"`.
        tilt_deg: the held tilt in degrees; a measurement takes its nearest node.
        fit: draw the diffuse part alone, over the same angles.
    """
    _check_3d(ax)
    view = view_of(source)
    title = "Fig. 8: diffuse fit" if fit else "Fig. 7: diffuse surface"
    over = ("receiving", "incidence")
    cut = or_say_missing(ax, title, lambda: view.samples.cut(over, {"tilt": tilt_deg}))
    if cut is None:
        return
    part = view.diffuse_factors(cut.deg)
    if fit and part is None:
        say_missing(ax, title, "the model has no diffuse part")
        return
    parts = cut.values if part is None else np.stack([cut.values, part])
    shown = part if fit and part is not None else cut.values
    _draw(ax, view, cut, ("receiving", "incidence"), shown, white=brightest(parts))
    heights = parts[..., view.shown]
    _frame(ax, view, f"{title}, {cut.held}", ("receiving", "incidence"), heights)
    ax.view_init(elev=26, azim=-122)


def plot_specular_surface(
    ax: Any, source: BrdfMeasurement | RadenBrdf | View, *, incidence_deg: float = 20.0
) -> None:
    """Figure 9: the specular part, total minus diffuse, over receiving × tilt at one incidence.

    Args:
        ax: axes with `projection="3d"`.
        incidence_deg: the held incidence in degrees; a measurement takes its nearest node.
    """
    _check_3d(ax)
    view, title = view_of(source), "Fig. 9: specular part"
    held = {"incidence": incidence_deg}
    cut = or_say_missing(ax, title, lambda: view.samples.cut(("receiving", "tilt"), held))
    if cut is None:
        return
    part = view.diffuse_factors(cut.deg)
    specular = cut.values if part is None else cut.values - part
    _draw(ax, view, cut, ("receiving", "tilt"), specular, white=brightest(specular))
    _frame(ax, view, f"{title}, {cut.held}", ("receiving", "tilt"), specular[..., view.shown])
    ax.view_init(elev=30, azim=-25)


def _draw(
    ax: Any, view: View, cut: Cut, over: tuple[str, str], values: Floats, *, white: float
) -> None:
    """A surface in true colour; dots where the readings are scattered."""
    x, y = (cut.deg[name] for name in over)
    height = values[..., view.shown]
    if not cut.joined:
        colours = true_colour(values, white)
        ax.scatter(x, y, height, c=colours, s=9, depthshade=False, edgecolors=_LINE, linewidths=0.4)
        return
    facets = (values[1:, 1:] + values[1:, :-1] + values[:-1, 1:] + values[:-1, :-1]) / 4
    ax.plot_surface(
        x,
        y,
        height,
        facecolors=true_colour(facets, white),
        rstride=1,
        cstride=1,
        shade=False,
        edgecolor=_LINE,
        linewidth=0.1 if view.is_model else 0.25,
    )


def _frame(ax: Any, view: View, title: str, over: tuple[str, str], heights: Floats) -> None:
    """Title, labels and limits."""
    channel = curves(view)[view.shown].name
    ax.set_title(title, fontsize=TEXT + 1, loc="left", color=INK)
    for set_label, name in zip((ax.set_xlabel, ax.set_ylabel), over, strict=True):
        set_label(f"{name} {_SYMBOLS[name]} (deg)", fontsize=TEXT)
    ax.set_zlabel(f"{channel}, reflectance factor\n(perfect diffuser = 100)", fontsize=TEXT)
    low, high = min(0.0, float(np.nanmin(heights))), float(np.nanmax(heights))
    ax.set_zlim(low, high if high > low else low + 1)
    ax.tick_params(labelsize=SMALL)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_pane_color((1, 1, 1, 0))
    ax.set_box_aspect((4, 4, 3), zoom=1.1)


def _check_3d(ax: Any) -> None:
    if not hasattr(ax, "plot_surface"):
        raise InputError('plot: expected axes with projection="3d", got ordinary axes')
