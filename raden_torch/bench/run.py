"""`raden bench`: run time against error, of every interpolator and backend, in one run.

Times are ratios within the run: to a copy of as many bytes as are read and written (the floor), and
to the naive eager form. Errors are against readings that no fit has seen, and, for the simulated
shell, against a sphere lit by the simulation itself.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.bench.bench_row import Row
from raden_torch.bench.simulated_truth import simulated_pair, sphere_delta_e
from raden_torch.bench.time_error_plot import save_plot
from raden_torch.bench.timing import (
    PRECISIONS,
    Shader,
    backends,
    frame_vectors,
    machine,
    scaling,
    time_ratios,
    without_gradients,
)
from raden_torch.brdf.fitting.fit import fit
from raden_torch.brdf.fitting.score import Score, angle_maps, score_of
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.shading.stress_geometries import worst_errors
from raden_torch.files import written_beside
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.readings import FACTOR_PER_SR
from raden_torch.packages import require
from raden_torch.reflectance.interpolation import SCHEMES

OUTPUTS = ("bench.json", "time_against_error.png")
"""What `run_bench` writes into its folder."""

_FRAME = (720, 1280)


def run_bench(
    out: Path,
    measurement: BrdfMeasurement | None = None,
    readings: BrdfMeasurement | None = None,
    *,
    say: Callable[[str], None] = print,
    frame: tuple[int, int] = _FRAME,
    compiled: bool = False,
) -> Path:
    """Measure, write `bench.json` and `time_against_error.png` into a folder.

    Args:
        measurement, readings: a grid, and readings off it; the simulated shell where None.
        frame: height and width of the timed frame in pixels.
        compiled: time the eager form under torch.compile, too.

    Returns:
        The path of the plot.
    """
    require("benchmarks", "plots")
    simulated = measurement is None or readings is None
    if measurement is None or readings is None:
        measurement, readings = simulated_pair()
    default_fit = fit(measurement)
    chosen = default_fit.report.interpolation
    models = {
        name: default_fit if name == chosen else fit(measurement, interpolation=name)
        for name in SCHEMES
    }
    vectors = frame_vectors(*frame)
    rows = []
    for name, result in models.items():
        delta_e = sphere_delta_e(result.model) if simulated else float("nan")
        for row, accuracy in _measured(result.model, name, readings, vectors, compiled):
            rows.append(replace(row, delta_e=delta_e))
            where = f"{name:10s} {row.backend:8s} {row.precision:8s}"
            say(f"{where} {row.times_floor:6.1f} x floor  {accuracy}")
    default = models[chosen].model
    about = {
        "sample": measurement.metadata.sample,
        "simulated": measurement.metadata.simulated,
        "frame": list(frame),
        "chosen": chosen,
        "machine": machine(),
        "rows": [_jsonable(asdict(row)) for row in rows],
        "scaling": scaling(default),
        "stability": _stability(default),
    }
    out.mkdir(parents=True, exist_ok=True)
    figures, picture = (out / name for name in OUTPUTS)
    with written_beside(figures) as temporary:
        temporary.write_text(json.dumps(about, indent=2) + "\n", "utf-8")
    save_plot(rows, chosen, measurement, picture)
    return picture


def _measured(
    model: RadenBrdf,
    scheme: str,
    readings: BrdfMeasurement,
    vectors: tuple[Tensor, Tensor, Tensor],
    compiled: bool,
) -> Iterator[tuple[Row, Score]]:
    """A row a backend and precision, without ΔE, and its error with the readings' number."""
    shaders = backends(model, compiled)
    ratios = time_ratios(shaders, vectors)
    table_bytes = 0 if model.table is None else model.table.values.numel() * 4
    for (backend, precision), shader in shaders.items():
        accuracy = _score(shader, readings, PRECISIONS[precision])
        row = Row(
            scheme=scheme,
            backend=backend,
            precision=precision,
            times_floor=ratios[backend, precision][0],
            times_naive=ratios[backend, precision][1],
            rms=accuracy.rms,
            log_error=accuracy.log_error,
            table_bytes=table_bytes,
        )
        yield row, accuracy


def _stability(model: RadenBrdf) -> dict[str, dict[str, dict[str, Any]]]:
    """Of each backend in single precision, the worst errors by region."""
    return {
        backend: {
            region: asdict(error)
            for region, error in worst_errors(shader, without_gradients(model)).items()
        }
        for (backend, precision), shader in backends(model).items()
        if backend != "naive" and precision == "float32"
    }


def _score(shader: Shader, readings: BrdfMeasurement, dtype: torch.dtype) -> Score:
    """The error through vectors of a precision, rather than by exact angles."""
    vectors = (v[None].to(dtype) for v in geometry.vectors_from_angles(*angle_maps(readings)))
    f = shader(*vectors)[0, :, :, 0].double().numpy().T
    return score_of(f * FACTOR_PER_SR, readings)


def _jsonable(row: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}
