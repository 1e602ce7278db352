"""Photographs of an inlay → what `raden relight` and `render` read: `raden capture texture`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.brdf.files.image_file import read_normal_map
from raden_torch.brdf.files.lit_model import load_lit
from raden_torch.brdf.files.model_file import save_model
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.materials.urushi import black_urushi
from raden_torch.capture.photo.capture_normals import LitSet, odd_lamps, read_lit_set
from raden_torch.capture.photo.colour import read_colour
from raden_torch.capture.photo.result_file import write_result
from raden_torch.capture.photo.segmentation import segment
from raden_torch.capture.photo.stored_photograph import Coding
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels
from raden_torch.images.pixels import read_pixels, write_pixels
from raden_torch.stereo.inlay import Inlay, find_inlay
from raden_torch.stereo.lamp_assignment import check_order, refuse
from raden_torch.stereo.photographed import Photographed
from raden_torch.stereo.solve import ModelNormals, residuals

FILES = {
    "gbuffer": "inlay.exr",
    "palette": "palette.safetensors",
    "material": "material.png",
    "mask": "mask.png",
}
_FEWEST_PX = 4


@dataclass(frozen=True)
class TextureOptions:
    """How an inlay is read.

    Attributes:
        models: one a shell.
        ground: of the lacquer between the pieces; black urushi where None.
        map: which shell each pixel shows, from 1 in the order of `models`, 0 for the ground;
            where None, pieces are looked for and each takes the shell that fits.
        normals: of the polished surface; it faces the camera where None.
        colour: of `raden capture colour`; without it the channels' balance is fitted.
        per_pixel: each pixel keeps its own layer normal.
        gain: keep the factor on the palette's reflection, pixel by pixel.
        smallest_px: an area of fewer pixels is no piece.
        exponent, keep_order, coded: as for `capture_normals`.
    """

    models: tuple[Path, ...]
    ground: Path | None = None
    map: Path | None = None
    normals: Path | None = None
    colour: Path | None = None
    per_pixel: bool = False
    gain: bool = False
    smallest_px: int = 16
    exponent: float | None = None
    keep_order: bool = False
    coded: Coding = "auto"

    @property
    def files(self) -> tuple[Path | None, ...]:
        """What is read beside photographs, lamps and mask."""
        return (*self.models, self.ground, self.map, self.normals, self.colour)


@dataclass(frozen=True, eq=False)
class FoundInlay:
    """The inlay, and what it was found with.

    Attributes:
        palette: the ground and the shells.
        surface: `[3, H·W]`; `residual`: `[K]`, of each photograph over its mean light.
    """

    inlay: Inlay
    palette: Palette
    given: LitSet
    surface: Tensor
    residual: Tensor
    notes: tuple[str, ...]

    @property
    def tilt_deg(self) -> Tensor:
        """`[H·W]` between the film layers and the surface."""
        near = torch.linalg.cross(self.inlay.layer_normal, self.surface, dim=0).norm(dim=0)
        return torch.rad2deg(torch.atan2(near, (self.inlay.layer_normal * self.surface).sum(0)))

    def __str__(self) -> str:
        """A line a shell: its pieces and how their layers lean."""
        tilt, lines = self.tilt_deg, []
        for place, name in enumerate(self.palette.names):
            there = self.inlay.material == place
            share = 100 * float(there.float().mean())
            line = f"{name}: {share:.1f} % of the picture"
            pieces = sum(piece.material == place for piece in self.inlay.pieces)
            if pieces:
                low, high = (float(x) for x in tilt[there].aminmax())
                line += f", {pieces} pieces, layers lean by {low:.1f} to {high:.1f} degrees"
            lines.append(line)
        return "\n".join(lines)


@torch.no_grad()
def capture_texture(
    photographs: Sequence[Path],
    lights: Path,
    mask: Path | None,
    options: TextureOptions,
    *,
    progress: Callable[[float], None] | None = None,
) -> FoundInlay:
    """Read photographs, lamps and models, and find the pieces' shells and layers.

    Raises:
        InputError: as for what it is made of; no piece; photographs in another order than the
            lamps.

    Warns:
        UserWarning: photographs that disagree with the others.
    """
    done = progress or (lambda share: None)
    if not options.models:
        raise InputError(
            "`model`: expected one for each shell, got none: a flat piece shows too few angles to "
            "fit one; measure the shell by `raden capture brdf` or `raden scan`"
        )
    shells = [_one(path) for path in options.models]
    ground = black_urushi() if options.ground is None else _one(options.ground)
    names = ["ground", *(path.stem for path in options.models)]
    palette = Palette([ground, *shells], names if len(set(names)) == len(names) else ())
    given = read_lit_set(
        photographs,
        lights,
        mask,
        exponent=options.exponent,
        coded=options.coded,
        progress=lambda share: done(0.2 * share),
    )
    pieces, known = _pieces(given, options)
    surface = _surface(given, options.normals)
    correction = None if options.colour is None else read_colour(options.colour)
    seen = Photographed.of(given, correction)
    inlay = find_inlay(
        seen,
        shells,
        pieces,
        surface,
        given=known,
        per_pixel=options.per_pixel,
        progress=lambda share: done(0.2 + 0.8 * share),
    )
    residual, wrong = _judged(seen, shells, inlay, surface, photographs)
    if wrong is not None and not options.keep_order:
        raise refuse(wrong, photographs[0])
    notes = [*([wrong] if wrong else []), *odd_lamps(residual, photographs)]
    for note in notes:
        warnings.warn(note, stacklevel=2)
    return FoundInlay(inlay, palette, given, surface, residual, tuple(notes))


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
                **({} if piece.layer_normal is None else {"layer_normal": piece.layer_normal}),
                "error_deg": round(piece.error_deg, 3),
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
    write_result(result, "inlay", content, made_from=photographs)
    return [result, gbuffer, palette, material, mask]


def _one(path: Path) -> Reflection:
    model = load_lit(path)
    if isinstance(model, Palette):
        if len(model) != 1:
            raise InputError(
                f"{path}: expected the model of one shell, got a palette of {len(model)}; give "
                "its members one by one"
            )
        return model[0]
    return model


def _pieces(
    given: LitSet, options: TextureOptions
) -> tuple[NDArray[np.int32], NDArray[np.int64] | None]:
    """Numbered from 1 by falling area, `[H, W]`; and the shell of each where a map tells."""
    import cv2

    if options.map is None:
        photos = [p.movedim(0, -1).numpy() for p in given.photos.images]
        shells = len(options.models)
        index = segment(photos, shells, smallest_px=options.smallest_px).index.astype(np.int64)
    else:
        index = _read_map(options.map, given.photos.size, len(options.models))
    index = np.where(given.mask > 0.5, index, 0)
    pieces, shell = np.zeros(index.shape, np.int32), []
    sizes: list[tuple[int, int, int]] = []
    labels = {}
    for value in range(1, int(index.max(initial=0)) + 1):
        count, labels[value], stats, _ = cv2.connectedComponentsWithStats(
            (index == value).astype(np.uint8), connectivity=4
        )
        areas = stats[:, cv2.CC_STAT_AREA]
        sizes += [(int(areas[k]), value, k) for k in range(1, count)]
    kept = sorted((s for s in sizes if s[0] >= max(options.smallest_px, _FEWEST_PX)), reverse=True)
    if not kept:
        raise InputError(
            f"{options.map or 'photographs'}: expected at least one piece of "
            f"{options.smallest_px} pixels within the mask, got none"
        )
    for number, (_, value, k) in enumerate(kept):
        pieces[labels[value] == k] = number + 1
        shell.append(value - 1)
    return pieces, None if options.map is None else np.array(shell)


def _read_map(path: Path, size: tuple[int, int], shells: int) -> NDArray[np.int64]:
    pixels = read_pixels(path, colour=False)
    if pixels.ndim == 3 and (pixels == pixels[..., :1]).all():
        pixels = pixels[..., 0]
    if pixels.ndim != 2 or pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"{path}: expected a map of one channel of 8 or 16 bits, whose values are indices"
        )
    if pixels.shape != size:
        raise InputError(
            f"{path}: expected the photographs' {size[1]} x {size[0]} pixels, got "
            f"{pixels.shape[1]} x {pixels.shape[0]}"
        )
    if int(pixels.max()) > shells:
        raise InputError(
            f"{path}: expected indices 0…{shells}, 0 for the ground and one a model, got "
            f"{int(pixels.max())}"
        )
    return pixels.astype(np.int64)


def _surface(given: LitSet, path: Path | None) -> Tensor:
    """`[3, H·W]`"""
    height, width = given.photos.size
    up = torch.tensor([[0.0], [0.0], [1.0]]).repeat(1, height * width)
    if path is None:
        return up
    normal = read_normal_map(path)
    if normal.shape[2:] != (height, width):
        raise InputError(
            f"{path}: expected the photographs' {width} x {height} pixels, got "
            f"{normal.shape[3]} x {normal.shape[2]}"
        )
    flat = normal[0].flatten(1).float()
    return torch.where((flat != 0).any(0), flat, up)


def _judged(
    seen: Photographed,
    shells: Sequence[Reflection],
    inlay: Inlay,
    surface: Tensor,
    photographs: Sequence[Path],
) -> tuple[Tensor, str | None]:
    """How far each photograph is from what was found, `[K]`; whether another order fits."""
    there = (inlay.material > 0).nonzero()[:, 0]
    index = there[:: max(1, len(there) >> 12)]
    light = replace(seen.at(index), surface=surface[:, index])
    gain = inlay.gain[:, index].mean(0) * inlay.exposure
    zero = torch.zeros(len(index))
    found = ModelNormals(inlay.layer_normal[:, index], gain, zero, zero, inlay.material[index] - 1)
    _, off = residuals(shells, light, found)
    return torch.nanmedian(off, dim=1).values, check_order(shells, light, found, photographs)
