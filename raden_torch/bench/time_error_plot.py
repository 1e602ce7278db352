"""Run time against error, a mark a row: inside the measured box and outside it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from raden_torch.bench.bench_row import Row
from raden_torch.bench.forms import COMPILED, EAGER, FIT, NAIVE, PAPER, RUNTIME
from raden_torch.files import written_beside
from raden_torch.measurement import Metadata
from raden_torch.packages import require

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

_COLOURS = {NAIVE: "#444444", EAGER: "#0072b2", COMPILED: "#56b4e9"}
_KERNEL_COLOURS = ("#e69f00", "#009e73", "#cc79a7")  # the slowest instruction set first
_MARKERS = {PAPER: "s", FIT: "^", RUNTIME: "o"}
_KINDS = {"rms": "RMS / 99.9 % quantile of Y", "log_error": "mean |Δ log(1+Y)|"}
_PANELS = ("inside", "outside")


def save_plot(rows: list[Row], about: Metadata, path: Path) -> None:
    """Write the panels as a PNG, over the copy's time: a column a region that has readings, a row
    an error. Colours are backends and shapes forms; runtime tables are joined from few nodes to
    many; hollow marks are maps of another precision than float32."""
    require("graphs", "plots")
    from matplotlib.figure import Figure

    colours = _colours(row.backend for row in rows)
    regions = [name for name in _PANELS if name in rows[0].errors]
    figure = Figure(figsize=(3.2 + 4.4 * len(regions), 7.6), layout="constrained")
    panels = figure.subplots(2, len(regions), sharex=True, squeeze=False)
    for line, (kind, label) in zip(panels, _KINDS.items(), strict=True):
        for ax, region in zip(line, regions, strict=True):
            _panel(ax, rows, region, kind, colours)
        line[0].set_ylabel(label)
    for ax, region in zip(panels[0], regions, strict=True):
        count = rows[0].errors[region].readings
        ax.set_title(f"{region} the measured box, {count} readings", fontsize=10)
    for ax in panels[1]:
        ax.set_xlabel("run time / copy of the same bytes")
    figure.legend(handles=_keys(rows, colours), loc="outside right center", fontsize=8)
    kind = "simulated specimen: " if about.simulated else ""
    figure.suptitle(f"{kind}{about.sample[:60]}", fontsize=11)
    with written_beside(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")


def _panel(ax: Axes, rows: list[Row], region: str, kind: str, colours: dict[str, str]) -> None:
    def error(row: Row) -> float:
        return float(getattr(row.errors[region], kind))

    for backend, colour in colours.items():
        sizes = _tables(rows, backend)
        ax.plot(
            [row.times_floor for row in sizes],
            [error(row) for row in sizes],
            color=colour,
            lw=0.8,
            zorder=1,
        )
    for row in rows:
        ax.scatter(
            row.times_floor,
            error(row),
            marker=_MARKERS[row.form] if row.backend != NAIVE else "X",
            edgecolors="black" if _is_default(row) else colours[row.backend],
            facecolors=colours[row.backend] if row.precision == "float32" else "none",
            s=90 if _is_default(row) else 36,
            zorder=3 if _is_default(row) else 2,
        )
    sizes = _tables(rows, _fastest(rows))
    ends = (sizes[0], sizes[-1]) if region == _PANELS[0] else ()  # beyond, sizes are alike
    for row in sizes:
        if row in ends or row.default:
            ax.annotate(
                f"{row.nodes / 1000:.0f}k",
                (row.times_floor, error(row)),
                (-9, 0),
                textcoords="offset points",
                fontsize=8,
                ha="right",
                va="top" if row is sizes[-1] else "center",
            )
    ax.set(xscale="log", yscale="log")
    ax.margins(x=0.15, y=0.1)
    ax.grid(alpha=0.3, which="both")


def _colours(backends: Iterable[str]) -> dict[str, str]:
    known = list(dict.fromkeys(backends))
    kernel = [name for name in reversed(known) if name not in _COLOURS]
    by_name = {**dict(zip(kernel, _KERNEL_COLOURS, strict=False)), **_COLOURS}
    return {name: by_name[name] for name in known}


def _tables(rows: list[Row], backend: str) -> list[Row]:
    """Runtime tables of all sizes, from few nodes to many."""
    found = [
        row
        for row in rows
        if (row.form, row.backend, row.precision) == (RUNTIME, backend, "float32")
    ]
    return sorted(found, key=lambda row: row.nodes)


def _fastest(rows: list[Row]) -> str:
    of = [row for row in rows if row.default and row.precision == "float32"]
    return min(of, key=lambda row: row.times_floor).backend


def _is_default(row: Row) -> bool:
    return row.default and row.precision == "float32"


def _keys(rows: list[Row], colours: dict[str, str]) -> list[Line2D]:
    from matplotlib.lines import Line2D

    def mark(label: str, marker: str, **options: object) -> Line2D:
        style = {"color": "#888888", "marker": marker, "ls": "", "label": label, **options}
        return Line2D([], [], **style)  # type: ignore[arg-type]

    keys = [mark(name, "D", color=colour) for name, colour in colours.items()]
    keys.append(mark("the paper's table, naive", "X"))
    keys.append(mark("the paper's table", _MARKERS[PAPER]))
    keys.append(mark("default fit, fit form", _MARKERS[FIT]))
    keys.append(mark("runtime form (k: 1000 nodes)", _MARKERS[RUNTIME], ls="-", lw=0.8))
    keys.append(mark("the default", _MARKERS[RUNTIME], mec="black", ms=9))
    if any(row.precision != "float32" for row in rows):
        keys.append(mark("maps not float32", _MARKERS[RUNTIME], mfc="none"))
    return keys
