"""Which material of a palette each pixel shows, as a file: indices, or weights.

Indices are whole numbers, from 0 in the palette's order: a grey PNG or TIFF of 8 or 16 bits, or one
channel of an EXR. Weights are channels of an EXR, LAYER.NAME for each of the palette's names, or
LAYER.0, LAYER.1, …: renderers and compositors write such files, and rows of them can be read.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import cast

import numpy as np
import torch
from torch import Tensor

from raden_torch.brdf.files.exr_tensors import stacked
from raden_torch.brdf.materials.palette import Palette
from raden_torch.errors import InputError
from raden_torch.images.exr_file import ExrFile, Key
from raden_torch.images.exr_layers import NAMES, Layers
from raden_torch.images.pixels import read_pixels

_WHOLE = 1e-3
"""How far from a whole number an index may be."""
_WHOLE_NUMBERS = (".png", ".tif", ".tiff")


class MaterialMap:
    """A map of materials whose rows are read when they are asked for; a PNG is kept, whole.

    Args:
        path: the map: .exr, .png, .tif or .tiff.
        palette: what is chosen of.
        size: height and width that the map has to have.
        layer: the layer or channel of an EXR; by default one of `NAMES`, or the only channel.
        file: the EXR, where it is open already.

    Attributes:
        keys: the channels of an EXR: one of indices, or one of weights a material.

    Raises:
        InputError: no such file or channel, another size, or values of no known kind.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        palette: Palette,
        size: tuple[int, int],
        layer: str | None = None,
        file: ExrFile | None = None,
    ) -> None:
        self.path, self._palette = path, palette
        self.keys: tuple[Key, ...] = ()
        self._pixels: Tensor | None = None
        self._file = file
        suffix = Path(path).suffix.lower()
        if suffix == ".exr":
            self._file = file or ExrFile(path)
            self.keys = _keys(self._file, palette, layer, is_own=file is None)
            found = self._file.size
        elif suffix in _WHOLE_NUMBERS:
            self._pixels = stored_indices(path)
            found = cast(tuple[int, int], tuple(self._pixels.shape))
        else:
            raise InputError(
                f"{path}: expected a material map in .exr, .png, .tif or .tiff, got {suffix}"
            )
        if found != size:
            raise InputError(
                f"{path}: expected a material map of {size[1]} x {size[0]} pixels, the size of "
                f"the image, got {found[1]} x {found[0]}"
            )

    def rows(self, top: int, bottom: int, mask: Tensor | None = None) -> Tensor:
        """`GBuffer.material` of some rows: `[1, 1, rows, W]` integers or `[1, K, rows, W]` weights.

        Args:
            mask: `[1, 1, rows, W]`; where it is 0, whatever the map holds does not matter.

        Raises:
            InputError: an index that is not whole or outside the palette, or weights that are
                negative or do not sum to 1.
        """
        if self._pixels is not None:
            found = self._pixels[None, None, top:bottom]
        else:
            found = stacked(cast(ExrFile, self._file), self.keys, top, bottom)
        if len(self.keys) > 1:
            self._palette.check_material(found, mask, where=str(self.path), first_row=top)
            if mask is None:
                return found
            first = torch.zeros_like(found)
            first[:, 0] = 1
            return torch.where(mask > 0, found, first)
        return self._indices(found, top, mask)

    def _indices(self, found: Tensor, top: int, mask: Tensor | None) -> Tensor:
        count = len(self._palette)
        nearest = found.round() if found.is_floating_point() else found
        good = ((found - nearest).abs() <= _WHOLE) & (nearest >= 0) & (nearest < count)
        bad = ~good if mask is None else ~good & (mask > 0)
        if bool(bad.any()):
            _, _, y, x = bad.nonzero()[0].tolist()
            raise InputError(
                f"{self.path}: material: expected indices 0…{count - 1} of the palette "
                f"({', '.join(self._palette.names)}), got {found[0, 0, y, x]:g} in row {top + y}, "
                f"column {x}"
            )
        small = torch.uint8 if count <= 256 else torch.int32
        return torch.where(good, nearest, torch.zeros_like(nearest)).to(small)


def nothing_to_choose(path: str | os.PathLike[str]) -> InputError:
    """What to raise where a map is given, and no palette."""
    return InputError(
        f"{path}: material: expected a palette to choose of, got the model of one measurement"
    )


def read_material(
    path: str | os.PathLike[str],
    palette: Palette,
    size: tuple[int, int],
    mask: Tensor | None = None,
) -> Tensor:
    """The whole of a material map; see `MaterialMap`."""
    return MaterialMap(path, palette, size).rows(0, size[0], mask)


def stored_indices(path: str | os.PathLike[str]) -> Tensor:
    """`[H, W]` whole numbers of a grey image, uint8 or int32.

    Raises:
        InputError: no image, or not one channel of 8 or 16 bits.
    """
    pixels = read_pixels(path, colour=False)
    if pixels.ndim == 3 and (pixels == pixels[..., :1]).all():
        pixels = pixels[..., 0]
    if pixels.ndim != 2 or pixels.dtype not in (np.uint8, np.uint16):
        channels = 1 if pixels.ndim == 2 else pixels.shape[2]
        raise InputError(
            f"{path}: expected a material map of one channel of 8 or 16 bits, whose values are "
            f"indices, got {channels} of {pixels.dtype}"
        )
    wide = pixels if pixels.dtype == np.uint8 else pixels.astype(np.int32)
    return torch.from_numpy(np.ascontiguousarray(wide))


def _keys(file: ExrFile, palette: Palette, layer: str | None, *, is_own: bool) -> tuple[Key, ...]:
    """The channel of indices, or those of weights in the palette's order.

    Args:
        is_own: the file holds nothing but the map, perhaps: its bare channels count, too.
    """
    layers = Layers.of(file, None)
    by_name = {name.lower(): key for name, key in layers.channels.items()}
    names = [name.lower() for name in palette.names]
    numbers = [str(place) for place in range(len(palette))]
    for wanted in [layer.lower()] if layer else NAMES["material"]:
        parts = _of_layer(by_name, wanted)
        for each in (names, numbers):
            if len(set(each)) > 1 and all(name in parts for name in each):
                return tuple(parts[name] for name in each)
        single = [k for n, k in by_name.items() if n == wanted or n.endswith(f".{wanted}")]
        if len(single) == 1 or len(parts) == 1:
            return (single[0] if single else next(iter(parts.values())),)
    if is_own and layer is None:
        if len(names) > 1 and all(name in by_name for name in names):
            return tuple(by_name[name] for name in names)
        if len(file.keys) == 1:
            return (next(iter(by_name.values())),)
    what = layer or "material"
    raise layers.missing(
        f"material: expected a channel {what} of indices, or {what}.NAME of weights for each of "
        f"{', '.join(palette.names)}",
        "material",
    )


def _of_layer(by_name: dict[str, Key], layer: str) -> dict[str, Key]:
    """What comes after the layer's name → channel: "view.material.akoya" → "akoya"."""
    found = {}
    for name, key in by_name.items():
        before, dot, rest = f".{name}".partition(f".{layer}.")
        if dot and (not before or before.startswith(".")):
            found[rest] = key
    return found
