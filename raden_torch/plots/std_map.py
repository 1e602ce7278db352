"""The map of a picture's standard deviations: own and systematic errors apart, and together."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch import Tensor

from raden_torch.arrays import Bools, Floats
from raden_torch.brdf.model.model import Provenance
from raden_torch.brdf.shading.radiance_std import RadianceStd
from raden_torch.plots.plot_style import (
    INK,
    SMALL,
    TEXT,
    UNMEASURED,
    families,
    printable,
    true_colour,
)

_GREEN = 1
_DARK = 0.003
"""Of the brightest pixel: below it a share of the radiance says nothing."""
_TOP = 0.99
"""Quantile of the pixels where the colours end."""
_DPI = 120
_SIZE = (14.6, 4.6)


def draw_std(image: Tensor, std: RadianceStd, about: Provenance) -> Figure:
    """The picture in true colour, and maps of its relative standard deviations in percent, in G,
    which stands for all channels as in the paper's figures.

    Args:
        image: `[1, 3, H, W]` scene-linear.
        std: of it.
        about: the sample's name, and whether it is simulated.
    """
    rgb = image[0].detach().double().cpu().numpy()
    level = rgb[_GREEN]
    shown = level > _DARK * max(float(level.max()), 1e-12)
    parts = {"own errors": std.own, "systematic errors": std.systematic, "together": std.total}
    shares = {
        name: _percent(part[0, _GREEN].detach().double().cpu().numpy(), level, shown)
        for name, part in parts.items()
    }
    figure = Figure(figsize=_SIZE, dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 4)
    bright = float(np.quantile(rgb.max(0)[shown], 0.995)) if shown.any() else 1.0
    axes[0].imshow(true_colour(np.moveaxis(rgb, 0, -1), bright))
    _title(axes[0], "picture, true colour")
    together = shares["together"][shown]
    top = float(np.quantile(together, _TOP)) if shown.any() else 1.0
    drawn: Any = None
    for ax, (name, share) in zip(axes[1:], shares.items(), strict=True):
        ax.set_facecolor(UNMEASURED)
        drawn = ax.imshow(share, cmap="cividis", vmin=0.0, vmax=max(top, 1e-6))
        middle = f"median {np.median(share[shown]):.2g} %" if shown.any() else "nothing is lit"
        _title(ax, f"{name}: {middle}")
    bar = figure.colorbar(drawn, ax=axes[1:], shrink=0.8, pad=0.01, extend="max")
    bar.set_label("standard deviation (k = 1), % of the radiance in G", fontsize=TEXT)
    bar.ax.tick_params(labelsize=SMALL)
    sample = about.sample or "an unnamed sample"
    head = f"simulated specimen: {sample}" if about.simulated else sample
    figure.suptitle(
        f"{printable(head)}\ngrey: masked or dark",
        family=families(head),
        parse_math=False,
        fontsize=TEXT + 2,
        color="#a3271f" if about.simulated else INK,
    )
    return figure


def _percent(std: Floats, level: Floats, shown: Bools) -> Floats:
    """`[H, W]`; NaN where it is not shown."""
    return np.where(shown, 100 * std / np.where(shown, level, 1.0), np.nan)


def _title(ax: Axes, text: str) -> None:
    ax.set_title(text, fontsize=TEXT + 1, loc="left", color=INK)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.spines[:].set_visible(False)
