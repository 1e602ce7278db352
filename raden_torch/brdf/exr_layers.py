"""The layers of an OpenEXR file, by their names: normals, positions, depth, mask, colour."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.errors import InputError
from raden_torch.images.exr import channel_keys, read_parts

NAMES: dict[str, tuple[str, ...]] = {
    "normal": (
        *("n", "normal", "normals", "ns", "nn", "normalworld", "normal_world", "worldnormal"),
        *("world_normal", "sh_normal", "shading_normal", "denoising normal"),
    ),
    "position": ("p", "position", "positions", "pos", "worldposition", "world_position", "pworld"),
    "depth": ("z", "depth", "zdepth", "depth_z"),
    "mask": ("mask", "a", "alpha"),
    "colour": ("", "rgba", "rgb", "beauty", "combined", "colour", "color"),
}
"""The layer names that are known, compared in lower case, the first one first. A name found
nowhere as a whole may be the last part of one layer's name ("ViewLayer.Normal")."""

UNIT_SHARE = 0.8
"""A bare RGB image holds normals where this share of its pixels that are not black has length 1."""
UNIT_TOLERANCE = 0.02

_VECTORS = ("xyz", "rgb")
_SCALARS = ("v", "z", "r", "y")


@dataclass(frozen=True)
class Layers:
    """The channels of a file by all the names that they go by.

    Attributes:
        arrays: by name; in a multi-part file also as "part.name".
        layers: layer in lower case → last part of the name in lower case → name.
        chosen: what the caller named.
        listing: the channels as `list_channels` names them, for messages.
    """

    path: str | os.PathLike[str]
    arrays: dict[str, NDArray[np.float32]]
    layers: dict[str, dict[str, str]]
    chosen: Mapping[str, str]
    listing: str

    @classmethod
    def of(cls, path: str | os.PathLike[str], chosen: Mapping[str, str] | None) -> Layers:
        unknown = [name for name in chosen or {} if name not in NAMES]
        if unknown:
            raise InputError(f"channels: {unknown[0]!r}; {', '.join(NAMES)} were wanted")
        parts = read_parts(path)
        keys = channel_keys(parts)
        arrays = {key: parts[part][name] for key, part, name in keys}
        if len(parts) > 1:
            for _, part, name in keys:
                arrays.setdefault(f"{part}.{name}", parts[part][name])
        layers: dict[str, dict[str, str]] = {}
        for name in arrays:
            layer, _, last = name.lower().rpartition(".")
            layers.setdefault(layer, {}).setdefault(last, name)
        shown = [key for key, _, _ in keys]
        more = f" and {len(shown) - 40} more" if len(shown) > 40 else ""
        return cls(path, arrays, layers, chosen or {}, ", ".join(shown[:40]) + more)

    @property
    def size(self) -> tuple[int, int]:
        height, width = next(iter(self.arrays.values())).shape
        return height, width

    def missing(self, what: str) -> InputError:
        return InputError(
            f"{self.path}: {what}; it has the channels {self.listing}: name a layer of them, as in "
            "normal=LAYER"
        )

    def camera_is_at_origin(self) -> InputError:
        return InputError(
            f"{self.path}: camera is given, but positions from depth have it at 0, 0, 0"
        )

    def normals(self) -> Tensor | None:
        """`[1, 3, H, W]`, decoded, 0 where there are none."""
        normal = self.vector("normal")
        return self.bare_normals() if normal is None else decoded(normal)

    def bare_normals(self) -> Tensor | None:
        """The bare R, G, B, decoded, if they are unit vectors and no layer is called normals.

        Some component must be negative: an image of pure red and blue has unit colours, too.
        """
        bare = self._stack(self._vector_in(""))
        if bare is None or "normal" in self.chosen or self._named("normal", self._vectors()):
            return None
        normal = decoded(bare)
        length = length_of(normal)
        unit = (length[length > 0] - 1).abs() < UNIT_TOLERANCE
        signed = bool((normal < -UNIT_TOLERANCE).any())
        return normal if signed and bool(unit.float().mean() >= UNIT_SHARE) else None

    def vector(self, what: str) -> Tensor | None:
        """`[1, 3, H, W]` of the layer that was named, else of a known one, else None."""
        names = None
        if what in self.chosen:
            text = self.chosen[what]
            names = self._listed(what, text) if "," in text else self._vector_in(text.lower())
            if names is None:
                raise self.missing(f"no layer {text!r} with X, Y, Z or R, G, B for the {what}")
        else:
            names = self._named(what, self._vectors())
        return self._stack(names)

    def scalar(self, what: str) -> Tensor | None:
        """`[1, 1, H, W]`, likewise."""
        if what in self.chosen:
            text = self.chosen[what]
            names = self._scalars().get(text.lower())
            if names is None:
                raise self.missing(f"no channel {text!r} for the {what}")
        else:
            names = self._named(what, self._scalars())
        return self._stack(names)

    def _named(
        self, what: str, candidates: Mapping[str, tuple[str, ...]]
    ) -> tuple[str, ...] | None:
        """The candidate with a known name; several by the last part of it are an error."""
        for name in NAMES[what]:
            if name in candidates:
                return candidates[name]
        for name in filter(None, NAMES[what]):
            found = {
                id(self.arrays[names[0]]): layer
                for layer, names in candidates.items()
                if layer.rpartition(".")[2] == name
            }
            if len(found) > 1 and what in ("normal", "depth"):
                several = ", ".join(found.values())
                raise self.missing(f"several layers may be the {what} ({several})")
            if len(found) == 1:
                return candidates[next(iter(found.values()))]
        return None

    def _vectors(self) -> dict[str, tuple[str, ...]]:
        found = {layer: self._vector_in(layer) for layer in self.layers}
        return {layer: names for layer, names in found.items() if names is not None}

    def _vector_in(self, layer: str) -> tuple[str, ...] | None:
        members = self.layers.get(layer, {})
        for letters in _VECTORS:
            if all(letter in members for letter in letters):
                return tuple(members[letter] for letter in letters)
        return None

    def _scalars(self) -> dict[str, tuple[str, ...]]:
        """Channels by their names, and layers that stand for one channel ("Depth.V")."""
        found: dict[str, tuple[str, ...]] = {}
        for layer, members in self.layers.items():
            vector = all(letter in members for letter in "xyz")
            for last, name in members.items():
                if not vector:
                    found[f"{layer}.{last}".lstrip(".")] = (name,)
        for layer, members in self.layers.items():
            letters = [letter for letter in _SCALARS if letter in members]
            if layer and letters and "x" not in members:
                found.setdefault(layer, (members[letters[0]],))
        return found

    def _listed(self, what: str, text: str) -> tuple[str, ...]:
        names = tuple(name.strip() for name in text.split(","))
        absent = [name for name in names if name not in self.arrays]
        if absent or len(names) != 3:
            raise self.missing(f"{text!r} for the {what} is not three of its channels")
        return names

    def _stack(self, names: tuple[str, ...] | None) -> Tensor | None:
        if names is None:
            return None
        return torch.from_numpy(np.stack([self.arrays[name] for name in names]))[None]


def decoded(normal: Tensor) -> Tensor:
    """Normals `[B, 3, H, W]` as stored → −1…1, and 0 where there are none.

    They are taken as (n + 1)/2 where no value is below −0.02 and the median vector comes nearer to
    unit length so. Then black pixels, and grey ones (0.5, 0.5, 0.5), have no normal.
    """
    finite = torch.isfinite(normal).all(dim=1, keepdim=True)
    normal = torch.where(finite, normal, torch.zeros_like(normal))
    there = (normal != 0).any(dim=1, keepdim=True)
    if not there.any() or bool((normal < -UNIT_TOLERANCE).any()):
        return normal
    spread = 2 * normal - 1
    as_is = (length_of(normal)[there] - 1).abs().median()
    by_half = (length_of(spread)[there] - 1).abs().median()
    if as_is <= by_half:
        return normal
    return torch.where(there & (length_of(spread) > 0.1), spread, torch.zeros_like(normal))


def length_of(vectors: Tensor) -> Tensor:
    return (vectors * vectors).sum(dim=1, keepdim=True).sqrt()  # vector_norm is 20 times slower
