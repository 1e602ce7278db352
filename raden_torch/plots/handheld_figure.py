"""What `raden capture handheld` found: where the camera looked from, and some pictures."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from raden_torch.arrays import Floats
from raden_torch.capture.photo.capture_handheld import Handheld
from raden_torch.plots.plot_style import FAINT, INK, SMALL, TEXT, printable

_KEPT, _LAMP, _LEFT_OUT = "#2f6db0", "#d55e00", "#a3271f"
_DPI = 110
_SHOWN = 8


def draw_handheld(found: Handheld) -> Figure:
    """Camera and lamps over the board on a dial, blur and exposure of the pictures in order, and
    pictures that were kept or left out."""
    figure = Figure(figsize=(11.5, 8.6), dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(4, 4)
    _draw_dial(figure.add_subplot(grid[:2, :2], projection="polar"), found)
    _draw_blur(figure.add_subplot(grid[0, 2:]), found)
    _draw_exposure(figure.add_subplot(grid[1, 2:]), found)
    for k, (number, refused) in enumerate(_examples(found)):
        ax = figure.add_subplot(grid[2 + k // 4, k % 4])
        each = found.looked_at[number]
        ax.imshow(each.thumbnail)
        ax.set_axis_off()
        said = "\n".join(printable(line) for line in (each.name, refused[:44] or "kept"))
        ax.set_title(
            said,
            fontsize=SMALL - 1,
            color=_LEFT_OUT if refused else INK,
        )
    figure.suptitle(
        "\n".join(printable(line) for line in textwrap.wrap(str(found).splitlines()[0], 150)),
        fontsize=TEXT,
    )
    return figure


def _draw_dial(ax: Any, found: Handheld) -> None:
    middle = found.setup.middle_m
    eyes = np.array([-p.rotation.T @ p.translation_m - middle for p in found.poses])
    ax.plot(*_polar(eyes), "o", color=_KEPT, markersize=3.5, label="camera")
    if not found.setup.lamp_on_camera:
        lamps = np.array([lamp.at_m - middle for lamp in found.lamps])
        ax.plot(*_polar(lamps), "*", color=_LAMP, markersize=12, label="lamp")
    ax.set_rlim(0, 90)
    ax.set_rgrids([30, 60], fontsize=SMALL - 1)
    ax.set_theta_direction(-1)  # y runs down the board
    ax.set_xticks(np.deg2rad([0, 90, 180, 270]))
    ax.set_xticklabels(["x", "y", "−x", "−y"], fontsize=SMALL)
    ax.grid(color=FAINT, linewidth=0.6)
    ax.legend(fontsize=SMALL - 1, loc="lower left", bbox_to_anchor=(-0.25, -0.05), frameon=False)
    ax.set_title("from where, over the board (degrees from its normal)", fontsize=SMALL, color=INK)


def _polar(away: Floats) -> tuple[Floats, Floats]:
    x, y, z = away.T
    return np.arctan2(y, x), np.degrees(np.arctan2(np.hypot(x, y), -z))


def _draw_blur(ax: Any, found: Handheld) -> None:
    blur = [(k, e.blur.worst_px) for k, e in enumerate(found.looked_at) if e.blur is not None]
    kept = set(found.chosen)
    for wanted, colour in ((False, FAINT), (True, _KEPT)):
        some = np.array([b for b in blur if (b[0] in kept) == wanted]).reshape(-1, 2)
        ax.plot(some[:, 0], some[:, 1], ".", color=colour if wanted else "#9aa0a6", markersize=5)
    lost = [k for k, each in enumerate(found.looked_at) if each.view is None]
    ax.plot(lost, np.zeros(len(lost)), "x", color=_LEFT_OUT, markersize=4)
    ax.axhline(found.setup.most_blur_px, color=_LEFT_OUT, linewidth=0.8)
    ax.set_ylabel("blur (px)", fontsize=SMALL)
    ax.set_ylim(-0.1, 2.2 * found.setup.most_blur_px)
    ax.set_title("pictures in order: blue kept, × without a board", fontsize=SMALL, color=INK)
    ax.tick_params(labelsize=SMALL - 1, length=2)


def _draw_exposure(ax: Any, found: Handheld) -> None:
    for channel, colour in enumerate(("#c0392b", "#2e8b57", _KEPT)):
        ax.plot(found.chosen, found.exposures[:, channel], ".", color=colour, markersize=4)
    ax.set_ylabel("exposure", fontsize=SMALL)
    ax.set_title("exposure by the white, R, G, B, over the median", fontsize=SMALL, color=INK)
    ax.tick_params(labelsize=SMALL - 1, length=2)


def _examples(found: Handheld) -> list[tuple[int, str]]:
    """Kept ones from begin to end, and one of each reason for leaving out."""
    first: dict[str, int] = {}
    for k, each in enumerate(found.looked_at):
        if each.refused:
            first.setdefault(each.reason, k)
    bad = [(k, found.looked_at[k].refused) for k in list(first.values())[: _SHOWN // 2]]
    count = min(len(found.chosen), _SHOWN - len(bad))
    some = np.unique(np.linspace(0, len(found.chosen) - 1, count).round().astype(int))
    return [(found.chosen[k], "") for k in some] + bad
