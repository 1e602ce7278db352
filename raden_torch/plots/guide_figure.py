"""Where piece, lamp and camera stand for planned photographs, and how the angles fill up."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.guide.plan import Plan
from raden_torch.capture.photo.guide.set_up import from_polar
from raden_torch.plots.plot_style import INK, SMALL, TEXT, UNMEASURED, families, printable
from raden_torch.reflectance.few_readings import GRID
from raden_torch.reflectance.symmetric_kriging import symmetric_images

_LAMP, _CAMERA, _PIECE = "#e0902a", "#2f6db0", "#9aa0a6"
_SLABS_DEG = (10, 30, 50, 70)
_DPI = 110
_MOST_NUMBERS = 40


def draw_plan(plan: Plan) -> Figure:
    """From above, from the side, the expected error, and the coverage filling up."""
    figure = Figure(figsize=(11.5, 8.2), dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.25, 1))
    above, below = parts
    top, side, error = above.subplots(1, 3, width_ratios=(1.25, 1.25, 0.8))
    _draw_places(top, plan, up=1, title="from above (cm)")
    _draw_places(side, plan, up=2, title="from the side (cm)")
    _draw_error(error, plan)
    _draw_filling(below, plan)
    figure.suptitle(
        printable(plan.head()), fontsize=TEXT, family=families(plan.head()), parse_math=False
    )
    return figure


def _draw_places(ax: Axes, plan: Plan, *, up: int, title: str) -> None:
    """Over the table, in the frame of its instructions; `up` is the axis that points up."""
    of_lamp = [
        (s.lamp_from_vertical_deg, s.lamp_azimuth_deg, s.lamp_distance_mm / 10)
        for s in plan.stances
    ]
    of_camera = [
        (s.camera_from_vertical_deg, s.camera_azimuth_deg, s.camera_distance_mm / 10)
        for s in plan.stances
    ]
    lamps, cameras = (from_polar(*np.array(polar).T) for polar in (of_lamp, of_camera))
    width, height = (size / 10 for size in plan.piece.size_mm)
    if up == 1:
        corner, shown = (-width / 2, -height / 2), (width, height)
    else:
        corner, shown = (-width / 2, -0.8), (width, 0.8)
        ax.axhline(0, color=INK, linewidth=0.8)
    ax.add_patch(Rectangle(corner, *shown, facecolor=_PIECE, edgecolor=INK, linewidth=0.6))
    for places, colour, marker, name in (
        (cameras, _CAMERA, "s", "camera"),
        (lamps, _LAMP, "o", "lamp"),
    ):
        ax.plot(places[:, 0], places[:, up], marker, color=colour, markersize=4, label=name)
        for place, numbers in _numbers(places[:, [0, up]]):
            ax.annotate(numbers, place, xytext=(3, 2), textcoords="offset points",
                        fontsize=SMALL - 2, color=colour)  # fmt: skip
    start = f"0 deg: {plan.set_up.azimuth_from} →"
    ax.set_xlabel(start if up == 1 else "", fontsize=SMALL)
    ax.set_title(title, fontsize=SMALL, color=INK)
    ax.set_aspect("equal", adjustable="box")
    reach = 1.08 * float(np.linalg.norm(np.concatenate([lamps, cameras]), axis=1).max())
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-reach if up == 1 else -0.12 * reach, reach)
    ax.tick_params(labelsize=SMALL - 1, length=2)
    if up == 1:
        ax.legend(fontsize=SMALL - 1, loc="upper left", frameon=False)


def _numbers(places: Floats) -> list[tuple[tuple[float, float], str]]:
    """Each place once, with the first of its photographs."""
    at, first, count = np.unique(np.round(places, 1), axis=0, return_index=True, return_counts=True)
    order = np.argsort(first)[:_MOST_NUMBERS]
    return [
        ((float(at[k, 0]), float(at[k, 1])), f"{first[k] + 1}" + ("…" if count[k] > 1 else ""))
        for k in order
    ]


def _draw_error(ax: Axes, plan: Plan) -> None:
    ax.plot(np.arange(len(plan.expected)), 100 * plan.expected, "-", color=INK, linewidth=1.2)
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_title("expected error of the hemisphere (%)", fontsize=SMALL, color=INK)
    ax.set_xlabel("photographs", fontsize=SMALL)
    ax.tick_params(labelsize=SMALL - 1, length=2, which="both")
    ax.grid(color="0.9", which="both", linewidth=0.5)


def _draw_filling(figure: Any, plan: Plan) -> None:
    """Which photograph reads each cell first, with what the declared symmetries say of it."""
    table = first_photograph(plan)
    axes = figure.subplots(1, len(_SLABS_DEG), sharey=True)
    edge = GRID.high[2] + GRID.step[2] / 2
    for ax, incidence in zip(axes, _SLABS_DEG, strict=True):
        ax.set_facecolor(UNMEASURED)
        slab = np.ma.masked_less(table[GRID.incidence_deg == incidence][0].T, 0)
        shown = ax.imshow(slab, extent=(-edge, edge, -edge, edge), origin="lower",
                          cmap="viridis_r", vmin=0, vmax=len(plan.stances))  # fmt: skip
        ax.axvline(incidence, color="white", linewidth=0.8, linestyle=(0, (4, 2)))
        ax.set_title(f"incidence {incidence}°", fontsize=SMALL, color=INK, pad=3)
        ax.set_xlabel("receiving (°)", fontsize=SMALL)
        ax.tick_params(labelsize=SMALL - 1, length=2)
    axes[0].set_ylabel("tilt (°)", fontsize=SMALL)
    bar = figure.colorbar(shown, ax=list(axes), shrink=0.85, aspect=25, pad=0.01)
    bar.set_label("read first by photograph (0: before)", fontsize=SMALL)
    bar.locator = MaxNLocator(integer=True)
    bar.update_ticks()
    bar.ax.tick_params(labelsize=SMALL - 1)


def first_photograph(plan: Plan) -> NDArray[np.int64]:
    """`[A, R, T]` at the nodes of `GRID`: the photograph, from 1, that reads a cell first; 0 what
    was read before, −1 nothing."""
    table = np.full(GRID.shape, -1, np.int64)
    for number, angles in reversed(list(enumerate([plan.known, *plan.readings]))):
        node = np.rint(GRID.positions(symmetric_images(angles, plan.assume))).astype(int)
        node = node[((node >= 0) & (node < GRID.shape)).all(axis=1)]
        table[tuple(node.T)] = number
    return table
