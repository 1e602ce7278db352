"""`raden bench`: run time against error, of every interpolator and backend, in one run.

Times are ratios within the run: to a copy of as many bytes as are read and written (the floor), and
to the naive eager form. Errors are against readings that no fit has seen, and, for the simulated
shell, against a sphere lit by the simulation itself.
"""

from __future__ import annotations

import json
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.fitting.fit import fit
from raden_torch.brdf.fitting.score import Score, angle_maps, score_of
from raden_torch.brdf.model import simd
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import DirectionalLight
from raden_torch.brdf.shading.shade import shade
from raden_torch.brdf.shading.sphere_gbuffer import sphere
from raden_torch.brdf.shading.stress_geometries import worst_errors
from raden_torch.files import written_beside
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from raden_torch.measurement.readings import FACTOR_PER_SR
from raden_torch.optics import simulate_specimen
from raden_torch.packages import require
from raden_torch.reflectance.interpolation import SCHEMES

SPECIMEN = "yakogai"
SCALING = (64, 256, 1024, 2048)
"""Sides of square frames, in pixels."""

PRECISIONS = {
    "float32": torch.float32,
    "float64": torch.float64,
    "float16": torch.float16,
    "bfloat16": torch.bfloat16,
}
"""Of the maps; half precision is computed in float32."""

_OFF_GRID, _RUNS, _FRAME = 4000, 9, (720, 1280)
_LIGHT = (1.0, 1.0, 2.0)

Shader = Callable[[Tensor, Tensor, Tensor], Tensor]


OUTPUTS = ("bench.json", "time_against_error.png")
"""What `run_bench` writes into its folder."""


@dataclass(frozen=True)
class Row:
    """One interpolator in one backend.

    Attributes:
        scheme, backend, precision: what ran.
        times_floor, times_naive: run time over a copy of the same bytes, and over the naive form.
        rms, log_error: as in `score.Score`.
        delta_e: mean ΔE2000 of a lit sphere against the simulation; NaN without one.
        table_bytes: of the table.
    """

    scheme: str
    backend: str
    precision: str
    times_floor: float
    times_naive: float
    rms: float
    log_error: float
    delta_e: float
    table_bytes: int


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
        shaders = backends(result.model, compiled)
        ratios = _ratios(shaders, vectors)
        for (backend, precision), shader in shaders.items():
            accuracy = _score(shader, readings, PRECISIONS[precision])
            times_floor, times_naive = ratios[backend, precision]
            rows.append(
                Row(
                    scheme=name,
                    backend=backend,
                    precision=precision,
                    times_floor=times_floor,
                    times_naive=times_naive,
                    rms=accuracy.rms,
                    log_error=accuracy.log_error,
                    delta_e=delta_e,
                    table_bytes=_table_bytes(result.model),
                )
            )
            say(f"{name:10s} {backend:8s} {precision:8s} {times_floor:6.1f} x floor  {accuracy}")
    default = models[chosen].model
    about = {
        "sample": measurement.metadata.sample,
        "simulated": measurement.metadata.simulated,
        "frame": list(frame),
        "chosen": chosen,
        "machine": machine(),
        "rows": [_jsonable(asdict(row)) for row in rows],
        "scaling": _scaling(default),
        "stability": {
            backend: {
                region: asdict(error)
                for region, error in worst_errors(shader, _no_grad(default)).items()
            }
            for (backend, precision), shader in backends(default).items()
            if backend != "naive" and precision == "float32"
        },
    }
    out.mkdir(parents=True, exist_ok=True)
    figures, picture = (out / name for name in OUTPUTS)
    with written_beside(figures) as temporary:
        temporary.write_text(json.dumps(about, indent=2) + "\n", "utf-8")
    _plot(rows, chosen, measurement, picture)
    return picture


def simulated_pair() -> tuple[BrdfMeasurement, BrdfMeasurement]:
    """The built-in shell on its grid, and off it."""
    u = np.random.default_rng(0).random((_OFF_GRID, 3))
    geometries = u * [70.0, 140.0, 140.0] - [0.0, 70.0, 70.0]
    return simulate_specimen(SPECIMEN), simulate_specimen(SPECIMEN, geometries_deg=geometries)


def frame_vectors(height: int, width: int) -> tuple[Tensor, Tensor, Tensor]:
    """Normal, light and view of a wavy surface under a near lamp: coherent, as pictures are."""
    y, x = torch.meshgrid(
        torch.linspace(-1, 1, height), torch.linspace(-1, 1, width), indexing="ij"
    )
    slope_x, slope_y = 0.5 * torch.sin(9 * x + 3 * y), 0.5 * torch.cos(7 * y - 2 * x)
    normal = torch.stack([slope_x, slope_y, torch.ones_like(x)])[None]
    position = torch.stack([x, y, torch.zeros_like(x)])[None]
    light = torch.tensor([0.7, 0.9, 1.6]).view(1, 3, 1, 1) - position
    view = torch.tensor([0.0, 0.0, 3.0]).view(1, 3, 1, 1) - position
    unit = torch.nn.functional.normalize
    return unit(normal, dim=1), unit(light, dim=1), unit(view, dim=1)


def backends(model: RadenBrdf, compiled: bool = False) -> dict[tuple[str, str], Shader]:
    """Every way of this machine to evaluate a model without gradients, by backend and precision.

    `compiled` adds the eager form under torch.compile, which needs a compiler and its time.
    """
    found: dict[tuple[str, str], Shader] = {}
    for level in reversed(simd.LEVELS):
        found[level, "float32"] = _no_grad(model, level)
    for precision in PRECISIONS:
        found["eager", precision] = _no_grad(model, simd.OFF)
    if compiled:
        torch.compiler.reset()  # else the models before this one count as its recompilations
        found["compiled", "float32"] = _no_grad(torch.compile(model), simd.OFF)
    if simd.LEVELS:
        found[simd.LEVELS[-1], "float16"] = _no_grad(model, simd.LEVELS[-1])
    if model.table is not None and model.table.pieces is None:
        found["naive", "float32"] = torch.no_grad()(partial(naive, model))
    return found


def _score(shader: Shader, readings: BrdfMeasurement, dtype: torch.dtype) -> Score:
    """The error through vectors of a precision, rather than by exact angles."""
    vectors = (v[None].to(dtype) for v in geometry.vectors_from_angles(*angle_maps(readings)))
    f = shader(*vectors)[0, :, :, 0].double().numpy().T
    return score_of(f * FACTOR_PER_SR, readings)


def naive(model: RadenBrdf, normal: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """The model as one writes it first: asin, atan2 and a 5-D grid_sample of the plain table.

    Differentiable; outside the table's box the diffuse part alone, without a fade.
    """
    table, diffuse = model.table, model.diffuse
    assert table is not None and diffuse is not None  # noqa: PT018
    volume = table.values.permute(3, 0, 1, 2)[None]
    first = torch.tensor(table.first_deg)
    span = torch.tensor(table.last_deg) - first
    scale, exponent = (p.view(1, 3, 1, 1) for p in (diffuse.scale, diffuse.exponent))
    unit = torch.nn.functional.normalize
    n, l, v = (unit(m, dim=1) for m in (normal, light, view))  # noqa: E741
    p = unit(torch.linalg.cross(l, v, dim=1), dim=1)
    projected = unit(n - geometry.dot(n, p) * p, dim=1)
    across = torch.linalg.cross(p, projected, dim=1)
    a = torch.atan2(-geometry.dot(l, across), geometry.dot(l, projected))
    r = torch.atan2(geometry.dot(v, across), geometry.dot(v, projected))
    t = torch.asin(geometry.dot(n, p).clamp(-1, 1))
    flip = torch.where(a < 0, -1.0, 1.0)
    a, r, t = a * flip, r * flip, t * flip
    at = torch.rad2deg(torch.cat([a, r, t], dim=1)) - first.view(1, 3, 1, 1)
    grid = (2 * at / span.view(1, 3, 1, 1) - 1).permute(0, 2, 3, 1).flip(-1)[:, None]
    specular = torch.nn.functional.grid_sample(
        volume, grid, align_corners=True, padding_mode="border"
    )[:, :, 0]
    body = scale * t.cos() * r.cos() * (1 - a.cos()).clamp(min=1e-12) ** exponent
    inside = (grid.abs() <= 1).all(dim=-1)
    f = torch.where(inside, specular, body)
    return torch.where((geometry.dot(n, l) > 0) & (geometry.dot(n, v) > 0), f, 0.0)


def sphere_delta_e(model: RadenBrdf, size: int = 96) -> float:
    """Mean ΔE2000 of a lit sphere against the simulation itself, evaluated at each pixel.

    Both are exposed so that the simulated sphere's 99.5 % quantile is white.
    """
    import colour

    gbuffer = sphere(size, samples=1)
    light = DirectionalLight(_LIGHT)
    with torch.no_grad():
        image = shade(model, gbuffer, light)
    truth, seen = _simulated_sphere(gbuffer)
    got = image[0].movedim(0, -1).reshape(-1, 3).numpy()[seen]
    white = np.quantile(truth @ np.linalg.inv(xyz_to_rgb_matrix())[1], 0.995)
    to_lab = [
        colour.XYZ_to_Lab(np.maximum(rgb @ np.linalg.inv(xyz_to_rgb_matrix()).T / white, 0))
        for rgb in (got, truth)
    ]
    return float(np.mean(colour.delta_E(*to_lab, method="CIE 2000")))


def _simulated_sphere(gbuffer: GBuffer) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """`[P, 3]` radiance of the pixels inside the measured box, and which pixels these are."""
    normal = gbuffer.normal
    light = torch.tensor(_LIGHT).view(1, 3, 1, 1).expand_as(normal)
    view = gbuffer.view_map(normal)
    angles = torch.cat(geometry.raden_angles(normal.double(), light.double(), view.double()), 1)
    degrees = torch.rad2deg(angles)[0].reshape(3, -1).T.numpy()
    cosine = geometry.dot(normal, torch.nn.functional.normalize(light, dim=1)).flatten().numpy()
    on = (gbuffer.mask > 0).flatten().numpy() if gbuffer.mask is not None else cosine > 0
    seen = on & (cosine > 0) & (degrees[:, 0] <= 70) & (abs(degrees[:, 1:]) <= 70).all(axis=1)
    rgb = simulate_specimen(SPECIMEN, geometries_deg=degrees[seen]).as_rgb().values
    return rgb / FACTOR_PER_SR * np.pi * cosine[seen, None], seen


def machine() -> dict[str, Any]:
    return {
        "processor": platform.processor() or platform.machine(),
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
        "python": platform.python_version(),
    }


def _no_grad(model: Shader, level: str | None = None) -> Shader:
    """The model without gradients, by the kernel's instruction set; by what it takes where None."""

    def shader(normal: Tensor, light: Tensor, view: Tensor) -> Tensor:
        with torch.no_grad(), simd.using(level or simd.level()):
            return model(normal, light, view)

    return shader


def _ratios(
    shaders: dict[tuple[str, str], Shader], vectors: tuple[Tensor, Tensor, Tensor]
) -> dict[tuple[str, str], tuple[float, float]]:
    """Run time over the floor and over the naive form, all in turn, medians."""
    source = torch.cat([m.flatten() for m in vectors])
    # as many bytes as three maps read and one written: two thirds of them there and back
    part = source[: len(source) * 2 // 3]
    target = torch.empty_like(part)
    maps = {name: [m.to(dtype) for m in vectors] for name, dtype in PRECISIONS.items()}
    floor, naive = ("floor", ""), ("naive", "float32")
    work: dict[tuple[str, str], Callable[[], object]] = {floor: partial(target.copy_, part)}
    work |= {key: partial(shader, *maps[key[1]]) for key, shader in shaders.items()}
    if naive not in work:
        work[naive] = partial(_reference_naive(), *vectors)
    times: dict[tuple[str, str], list[float]] = {key: [] for key in work}
    for _ in range(_RUNS):
        for name, run in work.items():
            run()  # what ran before has left its own memory behind
            start = time.perf_counter()
            run()
            times[name].append(time.perf_counter() - start)
    median = {name: statistics.median(taken) for name, taken in times.items()}
    return {k: (median[k] / median[floor], median[k] / median[naive]) for k in shaders}


def _reference_naive() -> Shader:
    """The naive form of a plain table of the paper's size, for schemes that have none."""
    from raden_torch.brdf.model.model import CosineDiffuse
    from raden_torch.brdf.model.reflectance_table import ReflectanceTable

    table = ReflectanceTable(torch.ones(15, 29, 29, 3), (0.0, -70.0, -70.0), (5.0, 5.0, 5.0))
    model = RadenBrdf(CosineDiffuse(torch.ones(3), torch.ones(3)), table)
    return torch.no_grad()(partial(naive, model))


def _scaling(model: RadenBrdf) -> list[dict[str, float]]:
    """Nanoseconds per pixel over the frame's size."""
    shader, rows = _no_grad(model), []
    for side in SCALING:
        vectors = frame_vectors(side, side)
        taken = []
        for turn in range(4):
            start = time.perf_counter()
            shader(*vectors)
            if turn:
                taken.append(time.perf_counter() - start)
        rows.append({"pixels": side * side, "ns_per_pixel": min(taken) / side**2 * 1e9})
    return rows


def _table_bytes(model: RadenBrdf) -> int:
    return 0 if model.table is None else model.table.values.numel() * 4


def _jsonable(row: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}


def _plot(rows: list[Row], chosen: str, measurement: BrdfMeasurement, path: Path) -> None:
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
