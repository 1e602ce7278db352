"""How far the runtime form is from the fit form and from the truth, by sample and table size.

Truth: readings of the simulated shells and of real materials that no fit has seen, off the grid
and, from `whole_hemisphere`, in directions to 80° (outside the measured box). Errors are the RMS
over the 99.9 % quantile of Y, and mean |Δ log(1+Y)|. Results also go to
benchmarks/results/runtime_form.json; nothing is timed. The real materials need the shared data and
are left out without.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import raden_torch as rt
from raden_torch.bench import simulated_pair
from raden_torch.bench.forms import with_nodes
from raden_torch.bench.region_errors import by_region
from raden_torch.brdf.fitting.score import Score, fit_form_factors, score, score_of
from raden_torch.brdf.model.layout_choice import NODES, bake_errors
from raden_torch.measurement import BrdfMeasurement
from raden_torch.optics import SPECIMENS
from raden_torch.reflectance.interpolation import SCHEMES

DATA = Path(__file__).resolve().parents[2] / "shared/data"
MATERIALS = ("pearl-paint", "color-changing-paint1", "spectralon_rgb")
NODE_COUNTS = (40_000, 75_000, NODES, 300_000)


def samples(names: list[str]) -> Iterator[tuple[str, BrdfMeasurement, dict[str, BrdfMeasurement]]]:
    """Name, measurement, and truth by where it lies."""
    for name in SPECIMENS:
        if name in names:
            measured, readings = simulated_pair(name)
            yield name, measured, {"": readings}
    for name in MATERIALS:
        file = DATA / "measured_brdf" / f"{name}.csv"
        if name in names and file.exists():
            whole = DATA / "whole_hemisphere" / f"{name}.hemisphere.csv"
            truth = {"inside": rt.load_measurement(file.with_suffix(".offgrid.csv"))}
            truth |= {"": rt.load_measurement(whole)} if whole.exists() else {}
            yield name, rt.load_measurement(file), truth


def regions(truth: dict[str, BrdfMeasurement], model: rt.RadenBrdf) -> dict[str, BrdfMeasurement]:
    """Readings inside and outside the measured box."""
    found = {name: m for name, m in truth.items() if name}
    if "" in truth:
        parts = by_region(truth[""], model)
        found = {name: parts[name] for name in ("inside", "outside") if name in parts} | found
    return found


def both(model: rt.RadenBrdf, readings: BrdfMeasurement) -> dict[str, Score]:
    """Errors of the two forms."""
    return {
        "fit form": score_of(fit_form_factors(model, readings), readings),
        "runtime form": score(model, readings),
    }


def say(error: object) -> str:
    return f"{error.rms:.4f}; {error.log_error:.4f}"  # type: ignore[attr-defined]


def measure(name: str, measured: BrdfMeasurement, truth: dict[str, BrdfMeasurement]) -> dict:
    """All of one sample, printed as it is found."""
    default = rt.fit(measured)
    chosen = default.report.interpolation
    model = default.model
    where = regions(truth, model)
    report: dict = {"interpolation": chosen, "schemes": {}, "nodes": {}}
    print(f"\n{name}: {chosen}")
    for scheme in SCHEMES:
        of = model if scheme == chosen else rt.fit(measured, interpolation=scheme).model
        found = {region: both(of, readings) for region, readings in where.items()}
        report["schemes"][scheme] = {
            region: {form: asdict(error) for form, error in errors.items()}
            for region, errors in found.items()
        }
        for region, errors in found.items():
            each = "   ".join(f"{form} {say(error)}" for form, error in errors.items())
            print(f"  {scheme:10s} {region:8s} {each}", flush=True)
    for nodes in NODE_COUNTS:
        of = with_nodes(model, nodes)
        errors = {**bake_errors(of), **{r: score(of, readings) for r, readings in where.items()}}
        report["nodes"][nodes] = {
            "layout": asdict(of.layout),
            **{region: asdict(error) for region, error in errors.items()},
        }
        each = "   ".join(f"{region} {say(error)}" for region, error in errors.items())
        print(f"  {nodes:7d} {of.layout.shape} {of.layout.warp} {each}", flush=True)
    return report


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=[*SPECIMENS, *MATERIALS])
    report = {name: measure(name, *of) for name, *of in samples(parser.parse_args().names)}
    out = Path(__file__).with_name("results") / "runtime_form.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
