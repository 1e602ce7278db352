"""Reflectance as a curve around the sample: polar, in the plane of incidence."""

from __future__ import annotations

from typing import Any

import numpy as np

from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.plots.plot_style import FACTOR_LABEL, INK, SMALL, TEXT, curves, or_say_missing
from raden_torch.plots.view import View, view_of

_LAMP = "#b8860b"


def plot_polar(
    ax: Any,
    source: BrdfMeasurement | RadenBrdf | View,
    *,
    incidence_deg: float = 20.0,
    tilt_deg: float = 0.0,
) -> None:
    """R, G and B over the receiving angle: the normal points up, the light comes from the left, and
    the mirror direction lies on the right.

    Args:
        ax: axes with `projection="polar"`.
        incidence_deg, tilt_deg: held, in degrees; a measurement takes its nearest node.

    Raises:
        InputError: other axes.
    """
    if not hasattr(ax, "set_theta_zero_location"):
        raise InputError('plot: expected axes with projection="polar", got ordinary axes')
    view, title = view_of(source), "Polar"
    held = {"incidence": incidence_deg, "tilt": tilt_deg}
    cut = or_say_missing(ax, title, lambda: view.samples.cut(("receiving",), held))
    if cut is None:
        return
    ax.set_theta_zero_location("N")
    ax.set_theta_direction(-1)
    ax.set_thetalim(-np.pi / 2, np.pi / 2)
    order = np.argsort(cut.deg["receiving"])
    around = np.deg2rad(cut.deg["receiving"][order])
    for curve in curves(view):
        values = np.maximum(cut.values[order, curve.channel], 0)
        style = "-" if cut.joined else "none"
        marker = "" if view.is_model else curve.marker
        ax.plot(around, values, color=curve.colour, ls=style, marker=marker, ms=3, label=curve.name)
    most = float(np.nanmax(cut.values))
    top = 1.05 * most if most > 0 else 1.0
    incidence = np.deg2rad(float(np.mean(cut.deg["incidence"])))
    for angle, colour, style, label in (
        (-incidence, _LAMP, "-", "light"),
        (incidence, INK, ":", "mirror r = a"),
    ):
        ax.plot([angle, angle], [0, top], color=colour, linestyle=style, linewidth=1.2, label=label)
    ax.set_ylim(0, top)
    ax.set_thetagrids(
        np.arange(-90, 91, 30), [f"{x:d}°".replace("-", "−") for x in range(-90, 91, 30)]
    )
    ax.tick_params(labelsize=SMALL)
    ax.set_rlabel_position(78)
    ax.grid(True, color="0.9", linewidth=0.8)
    ax.set_title(f"{title}, {cut.held}", fontsize=TEXT + 1, loc="left", color=INK)
    about = f"receiving r (deg); radius: {FACTOR_LABEL}"
    ax.text(0.5, 0.12, about, transform=ax.transAxes, ha="center", fontsize=TEXT)
    ax.legend(fontsize=SMALL, frameon=False, loc="upper left", bbox_to_anchor=(-0.12, 1.0))
