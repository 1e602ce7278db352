"""Run time against error, a mark a backend."""

from __future__ import annotations

from pathlib import Path

from raden_torch.bench.bench_row import Row
from raden_torch.files import written_beside
from raden_torch.measurement import BrdfMeasurement
from raden_torch.packages import require
from raden_torch.reflectance.interpolation import SCHEMES


def save_plot(rows: list[Row], chosen: str, measurement: BrdfMeasurement, path: Path) -> None:
    """Write the two panels as a PNG: RMS and mean logarithmic error, over the copy's time."""
    require("graphs", "plots")
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    figure = Figure(figsize=(11, 4.8), layout="constrained")
    markers = dict(zip(dict.fromkeys(row.backend for row in rows), "osD^vP", strict=False))
    colours = dict(
        zip(SCHEMES, ("#444444", "#0072b2", "#009e73", "#e69f00", "#56b4e9"), strict=False)
    )
    kinds = (("rms", "RMS / 99.9 % quantile of Y"), ("log_error", "mean |Δ log(1+Y)|"))
    for ax, (kind, label) in zip(figure.subplots(1, 2), kinds, strict=True):
        for row in rows:
            ax.scatter(
                row.times_floor,
                getattr(row, kind),
                marker=markers[row.backend],
                edgecolors=colours[row.scheme],
                facecolors=colours[row.scheme] if row.precision == "float32" else "none",
                s=70 if row.scheme == chosen else 36,
            )
        ax.set(xscale="log", yscale="log", xlabel="run time / copy of the same bytes", ylabel=label)
        ax.grid(alpha=0.3, which="both")
    keys = [Line2D([], [], color=c, marker="s", ls="", label=k) for k, c in colours.items()]
    keys += [Line2D([], [], color="#888888", marker=m, ls="", label=k) for k, m in markers.items()]
    keys.append(Line2D([], [], color="#888888", marker="o", mfc="none", ls="", label="not float32"))
    figure.legend(handles=keys, loc="outside right center", fontsize=8)
    kind = "simulated specimen: " if measurement.metadata.simulated else ""
    figure.suptitle(f"{kind}{measurement.metadata.sample[:60]}; default: {chosen}", fontsize=10)
    with written_beside(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")
