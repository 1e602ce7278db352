"""The normals of an object as files: maps that other programs read, and a small result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from msgspec import Struct
from torch import Tensor

from raden_torch.capture.photo.lamp_order import OrderCheck
from raden_torch.capture.photo.lamps import Lamps
from raden_torch.capture.photo.photometric_stereo import SurfaceNormals
from raden_torch.capture.photo.result_file import write_result
from raden_torch.images.exr import write_channels
from raden_torch.images.pixels import write_pixels
from raden_torch.schema import Triple

KIND = "normals"
FILES = {
    "normals": "normals.png",
    "maps": "normals.exr",
    "albedo": "albedo.png",
    "confidence": "confidence.png",
}
_BRIGHT = 0.995
"""The share of the object that the albedo's picture shows without clipping."""


class LitLamp(Struct):
    """One lamp of a normals file."""

    photograph: str
    direction_to_lamp: Triple


class NormalsFile(Struct):
    """What is read of a normals file: the lamps that its photographs were taken under."""

    lamps: tuple[LitLamp, ...]


def write_normals(
    found: SurfaceNormals,
    folder: Path,
    lamps: Lamps,
    photographs: Sequence[Path],
    *,
    method: str,
    exponent: float,
    made_by: str = "",
    order: OrderCheck | None = None,
    notes: Sequence[str] = (),
) -> list[Path]:
    """Write the maps and normals.json into a folder that exists; returns the files.

    normals.png: 16 bits, (n + 1)/2, x right, y up (green as OpenGL), black where there is none.
    normals.exr: floats: normal.X, .Y, .Z; albedo.R, .G, .B in the photographs' unit; confidence.V;
    error_deg.V. albedo.png: sRGB, scaled to the object's brightest. confidence.png: 0…1.

    Args:
        made_by: the model that the normals were found with, if one was; the albedo is then the
            factor on what it reflects.
    """
    there = (found.normal != 0).any(dim=1)[0].cpu().numpy()
    normal = found.normal[0].detach().float().cpu().numpy()
    albedo = found.albedo[0].detach().float().cpu()
    if len(albedo) == 1:
        albedo = albedo.expand(3, -1, -1)
    confidence = found.confidence[0, 0].detach().float().cpu().numpy()
    result, *maps = paths_in(folder)
    paths = dict(zip(FILES, maps, strict=True))
    coded = np.rint((normal + 1) / 2 * 65535 * there).astype(np.uint16)
    write_pixels(np.ascontiguousarray(coded.transpose(1, 2, 0)), paths["normals"])
    channels = {f"normal.{c}": m for c, m in zip("XYZ", normal, strict=True)}
    channels |= {f"albedo.{c}": m for c, m in zip("RGB", albedo.numpy(), strict=True)}
    channels |= {"confidence.V": confidence, "error_deg.V": found.error_deg[0, 0].cpu().numpy()}
    write_channels(paths["maps"], channels)
    write_pixels(_shown(albedo), paths["albedo"])
    write_pixels(np.rint(confidence * 65535).astype(np.uint16), paths["confidence"])
    content: dict[str, Any] = {
        "frame": "x right, y up, z to the viewer; normals point away from the surface",
        "green": "opengl",
        "method": method,
        **({"model": made_by} if made_by else {}),
        "response_exponent": round(exponent, 4),
        "files": FILES,
        "pixels_solved": int(there.sum()),
        "median_confidence": round(float(np.median(confidence[there])), 4) if there.any() else 0.0,
        "median_standard_error_deg": round(_median(found.error_deg, there), 3),
        "order_outside": None if order is None else round(order.outside, 5),
        "lamps": [
            {
                "photograph": path.name,
                "direction_to_lamp": np.round(lamps.direction[k], 6),
                "intensity": round(float(found.intensity[k]), 5),
                "relative_residual": _finite(float(found.lamp_residual[k])),
            }
            for k, path in enumerate(photographs)
        ],
        "notes": list(notes),
    }
    write_result(result, KIND, content, made_from=photographs)
    return [result, *paths.values()]


def paths_in(folder: Path) -> list[Path]:
    """What `write_normals` writes there: the result, then the maps in the order of `FILES`."""
    return [folder / "normals.json", *(folder / name for name in FILES.values())]


def _finite(residual: float) -> float | None:
    """None for a lamp that lights no pixel of the object."""
    return round(residual, 5) if math.isfinite(residual) else None


def _median(m: Tensor, there: np.ndarray[Any, np.dtype[np.bool_]]) -> float:
    values = m[0, 0].cpu().numpy()[there]
    return float(np.median(values)) if len(values) else 0.0


def _shown(albedo: Tensor) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """`[3, H, W]` linear → 8-bit sRGB `[H, W, 3]`."""
    from kornia.color import linear_rgb_to_rgb

    bright = albedo[albedo > 0].numpy()
    top = (
        float(np.quantile(bright[:: max(1, len(bright) // 100000)], _BRIGHT)) if len(bright) else 1
    )
    coded = linear_rgb_to_rgb((albedo / top).clamp(0, 1)[None])[0]
    return torch.round(coded * 255).to(torch.uint8).movedim(0, -1).contiguous().numpy()
