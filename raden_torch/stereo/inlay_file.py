"""A found inlay as files that `raden render` and `raden relight` read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.brdf.files.model_file import save_model
from raden_torch.capture.photo.result_file import write_result
from raden_torch.images.exr import write_channels
from raden_torch.images.pixels import write_pixels
from raden_torch.stereo.capture_texture import FoundInlay, TextureOptions

FILES = {
    "gbuffer": "inlay.exr",
    "palette": "palette.safetensors",
    "material": "material.png",
    "mask": "mask.png",
}


def paths_in(folder: Path) -> list[Path]:
    """What `write_inlay` writes there: the result, then `FILES`."""
    return [folder / "inlay.json", *(folder / name for name in FILES.values())]


def write_inlay(
    found: FoundInlay, folder: Path, photographs: Sequence[Path], options: TextureOptions
) -> list[Path]:
    """Write palette, G-buffer, maps and inlay.json into a folder that exists; returns the files."""
    inlay, (height, width) = found.inlay, found.given.photos.size
    result, gbuffer, palette, material, mask = paths_in(folder)

    def maps(values: Tensor) -> NDArray[np.float32]:
        return values.reshape(-1, height, width).float().numpy()

    inside = (found.given.mask > 0.5).astype(np.float32)
    index = maps(inlay.material)[0]
    channels = {f"normal.{c}": m for c, m in zip("XYZ", maps(found.surface), strict=True)}
    channels |= {
        f"layer_normal.{c}": m for c, m in zip("XYZ", maps(inlay.layer_normal), strict=True)
    }
    channels |= {"material.V": index, "mask.V": inside, "error_deg.V": maps(inlay.error_deg)[0]}
    if options.gain:
        gain = maps(inlay.gain).repeat(3 // len(inlay.gain), 0)
        channels |= {f"gain.{c}": m for c, m in zip("RGB", gain, strict=True)}
    save_model(found.palette, palette)
    write_channels(gbuffer, channels)
    write_pixels(index.astype(np.uint8), material)
    write_pixels((255 * inside).astype(np.uint8), mask)
    usual = float(found.residual.nanmedian())
    content: dict[str, Any] = {
        "frame": "x right, y up, z to the viewer",
        "materials": list(found.palette.names),
        "exposure": inlay.exposure,
        "files": FILES,
        "layers": "each pixel its own" if options.per_pixel else "one normal a piece",
        "pieces": [
            {
                "pixels": piece.pixels,
                "material": piece.material,
                "layer_normal": piece.layer_normal,
                "error_deg": round(piece.error_deg, 3),
                "varies_deg": round(piece.varies_deg, 3),
                "residual": round(piece.residual, 3),
                **({} if piece.runner_up is None else {"runner_up": round(piece.runner_up, 3)}),
            }
            for piece in inlay.pieces
        ],
        "photographs": [
            {"photograph": path.name, "relative_residual": round(float(r), 4)}
            for path, r in zip(photographs, found.residual, strict=True)
        ],
        "median_residual": round(usual, 4),
        "notes": list(found.notes),
    }
    if found.learnt is not None:
        content["learnt"] = {
            "what": "the shells' models were learnt from these photographs, not measured",
            "scale": "an albedo of 0.4 is assumed" if options.white is None else "by the white",
            "photographs": [path.name for path in photographs],
            "shells": {
                name: shell.as_dict()
                for name, shell in zip(found.palette.names[1:], found.learnt.shells, strict=True)
            },
        }
    write_result(result, "inlay", content, made_from=photographs)
    return [result, gbuffer, palette, material, mask]
