"""Two measurements against each other: where, and by how many standard deviations, they differ."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.compare import Comparison, compare
from raden_torch.plots.plot_style import INK, SMALL, TEXT, families, finish, printable, say_missing
from raden_torch.reflectance.regions import REGIONS

_INCIDENCES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)
_SLAB_DEG = 2.5
_MOST_STD = 4.0  # colours end there
_BINS = np.linspace(-5, 5, 51)
_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7")  # Okabe and Ito
_DPI = 120


def draw_comparison(first: BrdfMeasurement, second: BrdfMeasurement) -> Figure:
    """Maps of (second − first) / std over receiving × tilt, and their distribution by region.

    Raises:
        InputError: as `compare`.
    """
    c = compare(first, second)
    figure = Figure(figsize=(14.0, 8.6), dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    norm = TwoSlopeNorm(0.0, -_MOST_STD, _MOST_STD)
    points: Any = None
    for ax, incidence in zip(axes.flat, _INCIDENCES_DEG, strict=False):
        points = _map(ax, c, incidence, norm) or points
    if points is not None:
        bar = figure.colorbar(points, ax=axes, shrink=0.6, extend="both", pad=0.01)
        bar.set_label(f"(second − first) / std in {c.judged}", fontsize=TEXT)
        bar.ax.tick_params(labelsize=SMALL)
    _distribution(axes.flat[-1], c)
    _head(figure, c)
    return figure


def _map(ax: Axes, c: Comparison, incidence: float, norm: TwoSlopeNorm) -> Any:
    near = abs(c.angles_deg[:, 0] - incidence) <= _SLAB_DEG
    if not near.any():
        say_missing(ax, f"incidence {incidence:g}°", "not compared there")
        return None
    _, receiving, tilt = c.angles_deg[near].T
    points = ax.scatter(
        receiving, tilt, c=c.deviations[near], cmap="RdBu_r", norm=norm, s=26, marker="s", lw=0
    )
    ax.set_facecolor("0.88")
    finish(ax, f"incidence {incidence:g}° (± {_SLAB_DEG:g}°)", "receiving (deg)", "tilt (deg)")
    ax.set_aspect("equal")
    ax.grid(False)
    return points


def _distribution(ax: Axes, c: Comparison) -> None:
    middles = (_BINS[1:] + _BINS[:-1]) / 2
    ax.fill_between(middles, np.exp(-(middles**2) / 2) / np.sqrt(2 * np.pi), color="0.9")
    for name, colour in zip(REGIONS, _COLOURS, strict=True):
        mask = c.region_masks.get(name)
        if mask is None:
            continue
        inside = np.clip(c.deviations[mask], _BINS[0], _BINS[-1])
        density, _ = np.histogram(inside, _BINS, density=True)
        ax.step(middles, density, where="mid", color=colour, label=f"{name} ({mask.sum()})")
    ax.legend(fontsize=SMALL, frameon=False)
    finish(ax, "grey: as stated", "(second − first) / std", "density")


def _head(figure: Figure, c: Comparison) -> None:
    names = [
        f"{'simulated: ' if simulated else ''}{name or 'an unnamed sample'}"
        for name, simulated in zip(c.names, c.simulated, strict=True)
    ]
    head = f"{names[1]}  against  {names[0]}"
    verdict = str(c).splitlines()[-1]
    figure.suptitle(
        f"{printable(head[:150])}\n{verdict}",
        family=families(head),
        parse_math=False,
        fontsize=TEXT + 2,
        color="#a3271f" if any(c.simulated) else INK,
    )
