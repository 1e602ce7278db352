"""Which cells of the grid photographs cover, and which the suggestion would add."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from raden_torch.capture.photo.capture_brdf import CapturedBrdf
from raden_torch.plots.plot_style import INK, SMALL, TEXT, UNMEASURED, families, printable

_COLUMNS = 5
_MOST_SLABS = 15
_NEXT = "#f0a860"
_DPI = 110


def draw_captured(found: CapturedBrdf) -> Figure:
    """The coverage map of what `raden capture brdf` found."""
    cover, grid = found.coverage, found.grid
    about = found.measurement.metadata
    kind = "simulated photographs" if about.simulated else "photographs"
    title = (
        f"{about.sample}, {len(found.shots)} {kind} of a {found.shape}: {100 * cover.share:.1f} % "
        f"of the grid, {100 * cover.share_of_reachable:.1f} % of what the sample can show"
    )
    count = np.where(cover.covered, found.found.nodes.count, 0)
    return draw_coverage(
        count.reshape(grid.shape),
        cover.after.reshape(grid.shape),
        grid.step_deg,
        grid.limit_deg,
        title,
        simulated=about.simulated,
    )


def draw_coverage(
    count: NDArray[np.int64],
    added: NDArray[np.bool_],
    step_deg: float,
    limit_deg: float,
    title: str,
    *,
    simulated: bool = False,
) -> Figure:
    """A panel an incidence, receiving across and tilt up; colour: samples in a cell.

    Args:
        count: `[A, R, T]`, 0 where a cell is not covered.
        added: `[A, R, T]`, cells that the suggestion would cover as well.
        title: what was measured, and how much of it.
    """
    slabs = np.unique(np.rint(np.linspace(0, len(count) - 1, min(len(count), _MOST_SLABS))))
    columns = min(_COLUMNS, len(slabs))
    rows = -(-len(slabs) // columns)
    size = 2.3 * columns + 1.0, 2.25 * rows + 1.0
    figure = Figure(figsize=size, dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    edge = limit_deg + step_deg / 2
    box = (-edge, edge, -edge, edge)
    top = max(int(count.max()), 10)
    shown = None
    for ax, slab in zip(axes.flat, slabs.astype(int), strict=False):
        ax.set_facecolor(UNMEASURED)
        fresh = np.ma.masked_where(
            ~added[slab].T | (count[slab].T > 0), np.ones(added[slab].T.shape)
        )
        ax.imshow(fresh, extent=box, origin="lower", cmap=ListedColormap([_NEXT]), vmin=0, vmax=1)
        there = np.ma.masked_less(count[slab].T, 1)
        shown = ax.imshow(there, extent=box, origin="lower", cmap="viridis", norm=LogNorm(1, top))
        incidence = slab * step_deg
        ax.axvline(incidence, color="white", linewidth=0.8, linestyle=(0, (4, 2)))
        ax.set_title(f"incidence {incidence:g}°", fontsize=SMALL, color=INK, pad=3)
        ax.tick_params(labelsize=SMALL - 1, length=2)
        ax.set_xticks([-60, -30, 0, 30, 60])
        ax.set_yticks([-60, -30, 0, 30, 60])
    for ax in axes.flat[len(slabs) :]:
        ax.set_axis_off()
    for ax in axes[-1]:
        ax.set_xlabel("receiving (°)", fontsize=SMALL)
    for ax in axes[:, 0]:
        ax.set_ylabel("tilt (°)", fontsize=SMALL)
    if shown is not None:
        bar = figure.colorbar(shown, ax=axes, shrink=0.7, aspect=30, pad=0.015)
        bar.set_label("samples in a cell", fontsize=SMALL)
        bar.ax.tick_params(labelsize=SMALL - 1)
    figure.suptitle(
        printable(title)
        + "\ngrey: nothing; orange: what the suggested lamps would add; dashed: the mirror",
        fontsize=TEXT,
        family=families(title),
        parse_math=False,
        color="#a3271f" if simulated else INK,
    )
    return figure
