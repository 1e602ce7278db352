"""How far does a fit to few readings go? Error off the grid against the number of readings.

Three plans: grids of several steps, random cells, and the adaptive plan, each fitted with the
default `fit` and scored on readings that none of them saw. The simulated shell is asked at any
angle (`--noise` as a simulated rig has it). Of a material measured by others (`--material`, a CSV
on the raden grid with its `.offgrid.csv` beside it) a plan may read the grid's nodes and every
second off-grid row; the other rows are the score. Writes JSON, and a plot of both errors.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import raden_torch as rt
from raden_torch.brdf.fitting.score import score
from raden_torch.capture.spectrometer.adaptive import make_adaptive_plan
from raden_torch.capture.spectrometer.rehearsal import rehearse
from raden_torch.capture.spectrometer.scan_cells import grid, random_cells
from raden_torch.files import written_beside
from raden_torch.measurement import BrdfMeasurement

BUDGETS = (2000, 3000, 4000, 5046)
SHARE = 0.4  # of the full grid's 12,615
SHELLS = ("yakogai", "abalone", "akoya")

Floats = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
Sample = Callable[[Floats], BrdfMeasurement]


class Case:
    """A sample, the cells that can be read of it, and the readings that are the score."""

    def __init__(
        self, name: str, sample: Sample, candidates: Floats, coarse: list[Floats], random: Floats
    ) -> None:
        self.name, self.sample, self.candidates = name, sample, candidates
        self.grids, self.random = coarse, random
        self.truth: BrdfMeasurement

    def curves(self, budgets: tuple[int, ...]) -> Iterator[dict[str, object]]:
        for cells in self.grids:
            yield self._row("grid", cells)
        plan = make_adaptive_plan(
            self.candidates, self.name, coarse=self.grids[0], readings=max(budgets)
        )
        read = rehearse(plan, self.sample).cells
        for count in budgets:
            yield self._row("adaptive", read[:count])
            yield self._row("random", self.random[:count])

    def _row(self, plan: str, cells: Floats) -> dict[str, object]:
        result = rt.fit(self.sample(cells))
        found = score(result.model, self.truth)
        row: dict[str, object] = {
            "sample": self.name,
            "plan": plan,
            "readings": len(cells),
            "rms": found.rms,
            "log_error": found.log_error,
            "interpolation": result.report.interpolation,
        }
        print(json.dumps(row), flush=True)
        return row


def shell(name: str, noise: float) -> Case:
    def sample(cells: Floats) -> BrdfMeasurement:
        return rt.simulate_specimen(name, geometries_deg=cells, noise=noise)

    title = f"{name} (simulated{f', noise {noise:g}' if noise else ''})"
    grids = [grid(step_deg=step) for step in (10.0, 7.0, 5.0)]
    case = Case(title, sample, grid(step_deg=2.5), grids, random_cells(max(BUDGETS), seed=1))
    case.truth = rt.simulate_specimen(name, geometries_deg=random_cells(4000, seed=99))
    return case


def material(path: Path) -> Case:
    nodes = rt.load_measurement(path)
    rows = rt.load_measurement(path.with_suffix(".offgrid.csv"))
    even = np.arange(len(rows)) % 2 == 0
    known = _joined(nodes, rows.select(even))
    angles = _angles(known)
    row_of = {tuple(cell): row for row, cell in enumerate(angles.tolist())}

    def sample(cells: Floats) -> BrdfMeasurement:
        return known.select(np.array([row_of[tuple(cell)] for cell in cells.tolist()]))

    on = [np.isclose(angles[: len(nodes)] % step, 0).all(axis=1) for step in (10.0, 5.0)]
    grids = [angles[: len(nodes)][rows] for rows in on]
    shuffled = np.random.default_rng(1).permutation(angles)
    case = Case(path.stem, sample, angles, grids, shuffled)
    case.truth = rows.select(~even)
    return case


def _angles(m: BrdfMeasurement) -> Floats:
    return np.round(np.stack([m.incidence_deg, m.receiving_deg, m.tilt_deg], axis=1), 6)


def _joined(a: BrdfMeasurement, b: BrdfMeasurement) -> BrdfMeasurement:
    values = np.concatenate([a.as_xyz().values, b.as_xyz().values])
    return BrdfMeasurement(*np.concatenate([_angles(a), _angles(b)]).T, values)


def shares(rows: list[dict[str, object]]) -> list[str]:
    """Of the full grid's readings, how many the adaptive plan needs for the same error."""
    lines = []
    for name in dict.fromkeys(str(row["sample"]) for row in rows):
        mine = [row for row in rows if row["sample"] == name]
        full = max((r for r in mine if r["plan"] == "grid"), key=lambda r: int(str(r["readings"])))
        for error in ("rms", "log_error"):
            enough = [
                int(str(r["readings"]))
                for r in mine
                if r["plan"] == "adaptive" and float(str(r[error])) <= float(str(full[error]))
            ]
            total = int(str(full["readings"]))
            least = min(enough, default=0)
            text = f"{least} of {total} readings ({100 * least / total:.0f} %)"
            lines.append(f"{name}, {error}: {text if enough else 'not within these budgets'}")
    return lines


def plot(rows: list[dict[str, object]], path: Path) -> None:
    """Both errors over the readings, a row of graphs a sample."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(str(row["sample"]) for row in rows))
    looks = {"grid": ("#444444", "s"), "random": ("#d55e00", "^"), "adaptive": ("#0072b2", "o")}
    labels = {"rms": "RMS / 99.9 % quantile of Y", "log_error": "mean |Δ log(1+Y)|"}
    figure = Figure(figsize=(9, 3 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), 2, squeeze=False)
    for line, name in zip(axes, names, strict=True):
        for ax, error in zip(line, labels, strict=True):
            for plan, (colour, marker) in looks.items():
                mine = [r for r in rows if r["sample"] == name and r["plan"] == plan]
                mine.sort(key=lambda r: int(str(r["readings"])))
                x, y = ([r[key] for r in mine] for key in ("readings", error))
                ax.loglog(x, y, color=colour, marker=marker, label=plan)
            full = [r for r in rows if r["sample"] == name and r["plan"] == "grid"]
            last = max(full, key=lambda r: int(str(r["readings"])))
            ax.axhline(float(str(last[error])), color="#444444", linewidth=0.6, linestyle=":")
            ax.axvline(SHARE * int(str(last["readings"])), color="#444444", linewidth=0.6)
            ax.set_title(name, fontsize=9)
            ax.set_xlabel("readings (line: 40 % of the full grid)")
            ax.set_ylabel(labels[error])
            ax.set_xticks([2000, 5000, 12000], ["2000", "5000", "12000"])
            ax.set_xticks([], minor=True)
            ax.grid(alpha=0.3)
    axes[0][0].legend(fontsize=8)
    with written_beside(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shell", action="append", default=[], choices=SHELLS)
    parser.add_argument("--noise", type=float, action="append", help="of the shells; 0 where none")
    parser.add_argument("--material", type=Path, action="append", default=[])
    parser.add_argument("--out", type=Path, default=Path("build/measure_less.json"))
    options = parser.parse_args()
    names = options.shell or ([] if options.material else ["yakogai"])
    cases = [shell(name, noise) for name in names for noise in options.noise or [0.0]]
    cases += [material(path) for path in options.material]
    rows: list[dict[str, object]] = []
    options.out.parent.mkdir(parents=True, exist_ok=True)
    for case in cases:
        rows += case.curves(BUDGETS)
        options.out.write_text(json.dumps(rows, indent=1) + "\n")
        plot(rows, options.out.with_suffix(".png"))
    print("\n".join(shares(rows)))


if __name__ == "__main__":
    main()
