"""Does a browser give torch's picture with a text of `shading_language`? On the stress set."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.files.display import to_display
from raden_torch.errors import InputError
from raden_torch.export.forms import RuntimeForm
from raden_torch.export.shading_language import LANGUAGES
from raden_torch.export.stress_inputs import cases
from raden_torch.export.table_file import described, form_in
from raden_torch.export.workers.worker import PROGRAMS, Worker, WorkerError

LIMIT = 1 / 255
"""The largest difference allowed after the display transform, under a lamp of irradiance π."""

_VECTORS = ("normal", "light", "view")


@dataclass(frozen=True)
class ShaderCheck:
    """What a browser's picture is like.

    Attributes:
        runtime: the program that drew it.
        pixels: how many were compared.
        displayed: the largest difference after the display transform, of 1.
        per_sr: the largest difference of f_r, in 1/sr; `peak_per_sr` is the largest f_r.
    """

    runtime: str
    pixels: int
    displayed: float
    per_sr: float
    peak_per_sr: float

    def __str__(self) -> str:
        return (
            f"{self.runtime}: same picture, {self.pixels} pixels, at most "
            f"{self.displayed * 255:.3f}/255 after the display transform (allowed 1), "
            f"{self.per_sr:.1e} per sr of {self.peak_per_sr:.3g}"
        )


def verify_shader(path: str | os.PathLike[str], *, node_modules: Path) -> ShaderCheck:
    """Draw the stress set with an exported text in headless Chromium and compare with torch.

    Args:
        path: the .glsl or .wgsl file, with its table and the table's description beside it.
        node_modules: a folder with playwright-core.

    Raises:
        InputError: the files are missing or damaged, the browser is, it cannot compile the text, or
            it gives another picture.
    """
    path = Path(path)
    about, table = described(path)
    form = form_in(path, about, table)
    with _browser(path, about, table, node_modules) as worker:
        return _compared(path, form, worker)


def draw_shader(
    path: str | os.PathLike[str],
    normal: Tensor,
    light: Tensor,
    view: Tensor,
    *,
    node_modules: Path,
) -> Tensor:
    """What an exported text gives in headless Chromium, for pictures.

    Args:
        normal, light, view: `[B, 3, H, W]` unit vectors, or zero.

    Returns:
        `[B, 3, H, W]` f_r in 1/sr.

    Raises:
        InputError: as for `verify_shader`.
    """
    path = Path(path)
    with _browser(path, *described(path), node_modules) as worker:
        return _drawn(worker, *torch.broadcast_tensors(normal, light, view))


@contextmanager
def _browser(
    path: Path, about: dict[str, Any], table: bytes, node_modules: Path
) -> Iterator[Worker]:
    files = {
        "shader.txt": path.read_bytes(),
        "table.bin": table,
        "table.json": json.dumps(about).encode(),
    }
    try:
        worker = Worker(_command(path.suffix, node_modules), files)
        try:
            yield worker
        finally:
            worker.close()
    except WorkerError as error:
        raise InputError(f"{path}: the browser cannot run it: {error}") from None


def _compared(path: Path, form: RuntimeForm, worker: Worker) -> ShaderCheck:
    pixels, displayed, per_sr, peak = 0, 0.0, 0.0, 0.0
    for case in cases(form, "gbuffer", "brdf"):
        n, l, v = _units(case.inputs)  # noqa: E741
        if not n.numel():
            continue
        drawn = _drawn(worker, n, l, v)
        wanted = form.of_unit_vectors(n, l, v)
        # within rounding of the horizon either side is right
        edge = (geometry.dot(n, l).abs() < 1e-6) | (geometry.dot(n, v).abs() < 1e-6)
        difference = torch.where(edge, 0.0, (drawn - wanted).abs())
        radiance = (f * torch.pi * geometry.dot(n, l).clamp(min=0) for f in (drawn, wanted))
        seen = torch.where(edge, 0.0, torch.sub(*map(to_display, radiance)).abs())
        pixels += n.numel() // 3
        # a NaN counts as the largest difference
        displayed = max(displayed, float(seen.nan_to_num(1.0).max()))
        per_sr = max(per_sr, float(difference.nan_to_num(torch.inf).max()))
        peak = max(peak, float(wanted.abs().max()))
    if displayed > LIMIT:
        raise InputError(
            f"{path}: expected a picture within 1/255 of torch's, got one off by "
            f"{displayed * 255:.3g}/255"
        )
    name = f"{LANGUAGES[path.suffix]}, Chromium {worker.version}, SwiftShader"
    return ShaderCheck(name, pixels, displayed, per_sr, peak)


def _units(inputs: dict[str, Tensor]) -> list[Tensor]:
    """The case's vectors, unit to the last bit, or zero: what the text asks for."""
    unit = (geometry.normalised(inputs[name].double()).float() for name in _VECTORS)
    return list(torch.broadcast_tensors(*unit))


def _drawn(worker: Worker, *vectors: Tensor) -> Tensor:
    b, _, h, w = vectors[0].shape
    maps = {}
    for name, vector in zip(_VECTORS, vectors, strict=True):
        rows = torch.nn.functional.pad(vector.movedim(1, -1), (0, 1))
        maps[name] = rows.reshape(b * h, w, 4).numpy()
    return torch.from_numpy(worker.run(maps)).reshape(b, h, w, 4)[..., :3].movedim(-1, 1)


def _command(suffix: str, node_modules: Path) -> list[str]:
    node, browser = shutil.which("node"), shutil.which("chromium") or shutil.which("google-chrome")
    if node is None or browser is None:
        raise InputError("checking a shader: expected Node.js and Chromium, got a machine without")
    if not (node_modules / "playwright-core").is_dir():
        raise InputError(
            f"checking a shader: expected playwright-core in {node_modules}, got none; "
            "npm install playwright-core, or name the folder by --node-modules"
        )
    program = PROGRAMS / "graphics.mjs"
    return [node, str(program), str(node_modules), browser, suffix[1:]]
