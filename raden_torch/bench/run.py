"""`raden bench`: run time against error, of every form and backend, in one run.

Times are ratios within the run: to a copy of as many bytes as are read and written (the floor), and
to the naive form. Errors are against readings that no fit has seen, and, for the simulated shell,
against a sphere lit by the simulation itself.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from raden_torch.bench.bench_row import Row
from raden_torch.bench.forms import PRECISIONS, RUNTIME, Form, forms
from raden_torch.bench.region_errors import by_region, shader_score
from raden_torch.bench.simulated_truth import simulated_pair, sphere_delta_e
from raden_torch.bench.time_error_plot import save_plot
from raden_torch.bench.timing import frame_vectors, machine, scaling, time_ratios
from raden_torch.brdf.fitting.fit import fit
from raden_torch.brdf.shading.stress_geometries import worst_errors
from raden_torch.files import written_beside
from raden_torch.measurement import BrdfMeasurement
from raden_torch.packages import require

OUTPUTS = ("bench.json", "time_against_error.png")
"""What `run_bench` writes into its folder."""

_FRAME = (720, 1280)
_RUNS = 7


def run_bench(
    out: Path,
    measurement: BrdfMeasurement | None = None,
    readings: BrdfMeasurement | None = None,
    *,
    say: Callable[[str], None] = print,
    frame: tuple[int, int] = _FRAME,
    runs: int = _RUNS,
    compiled: bool = False,
) -> Path:
    """Measure, write `bench.json` and `time_against_error.png` into a folder.

    The keys of `bench.json`:

    - `sample`, `simulated`: of the measurement.
    - `frame`, `runs`: height and width of the timed frame in pixels; how often each form ran.
    - `default_nodes`, `interpolation`: of the default fit: the nodes of its runtime table, and what
      lies between the measured ones.
    - `machine`: processor, threads, versions of torch and Python.
    - `rows`: one a form, as in `Row`: `form` (see `forms`), `nodes` of its table, `default` (what
      users get), `backend`, `precision` of the maps; `times_floor`, `times_naive`; `errors` by
      region (`inside` and `outside` the measured box, `hemisphere`: all readings), each with
      `readings`, `rms`, `log_error` as in `Score`; `delta_e`, null of a real sample.
    - `scaling`: `ns_per_pixel` of the default over the `pixels` of a square frame.
    - `stability`: of the default's backends in single precision, by region of
      `stress_geometries`: `worst`, `typical` and `finite`.

    Args:
        measurement, readings: a grid, and readings off it; the simulated shell where None.
        frame: height and width of the timed frame in pixels.
        runs: how often each form is timed.
        compiled: time the eager form under torch.compile, too.

    Returns:
        The path of the plot.
    """
    require("benchmarks", "plots")
    simulated = measurement is None or readings is None
    if measurement is None or readings is None:
        measurement, readings = simulated_pair()
    default_fit = fit(measurement)
    default = default_fit.model
    paper = fit(measurement, interpolation="trilinear", outside="diffuse").model
    found = list(forms(paper, default, compiled))
    regions = by_region(readings, default)
    rows = []
    for form, times in zip(found, time_ratios(found, frame_vectors(*frame), runs), strict=True):
        rows.append(_row(form, times, regions, simulated))
        say(_in_words(rows[-1]))
    about = {
        "sample": measurement.metadata.sample,
        "simulated": measurement.metadata.simulated,
        "frame": list(frame),
        "runs": runs,
        "default_nodes": default.layout.nodes,
        "interpolation": default_fit.report.interpolation,
        "machine": machine(),
        "rows": [asdict(row) for row in rows],
        "scaling": scaling(default),
        "stability": _stability(found),
    }
    out.mkdir(parents=True, exist_ok=True)
    figures, picture = (out / name for name in OUTPUTS)
    with written_beside(figures) as temporary:
        temporary.write_text(json.dumps(about, indent=2) + "\n", "utf-8")
    save_plot(rows, measurement.metadata, picture)
    return picture


def _row(
    form: Form, times: tuple[float, float], regions: dict[str, BrdfMeasurement], simulated: bool
) -> Row:
    dtype = PRECISIONS[form.precision]
    return Row(
        form=form.form,
        nodes=form.nodes,
        default=form.default,
        backend=form.backend,
        precision=form.precision,
        times_floor=times[0],
        times_naive=times[1],
        errors={name: shader_score(form.shader, m, dtype) for name, m in regions.items()},
        delta_e=sphere_delta_e(form.shader) if simulated else None,
    )


def _in_words(row: Row) -> str:
    errors = "   ".join(
        f"{region} RMS {error.rms:.5f}, log {error.log_error:.5f}"
        for region, error in row.errors.items()
    )
    what = f"{row.form:12s} {row.nodes:6d} {row.backend:8s} {row.precision:8s}"
    return f"{what} {row.times_floor:6.1f} x floor   {errors}"


def _stability(found: list[Form]) -> dict[str, dict[str, dict[str, Any]]]:
    """Of each backend of the default in single precision, the worst errors by region."""
    default = [form for form in found if form.default and form.form == RUNTIME]
    reference = next(form.shader for form in default if form.precision == "float64")
    return {
        form.backend: {
            region: asdict(error) for region, error in worst_errors(form.shader, reference).items()
        }
        for form in default
        if form.precision == "float32"
    }
