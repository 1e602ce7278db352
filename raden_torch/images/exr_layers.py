"""The layers of an OpenEXR file, by their names: normals, positions, depth, mask, colour."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from raden_torch.errors import InputError
from raden_torch.images.exr_file import ExrFile, Key

NAMES: dict[str, tuple[str, ...]] = {
    "normal": (
        *("n", "normal", "normals", "ns", "nn", "normalworld", "normal_world", "worldnormal"),
        *("world_normal", "sh_normal", "shading_normal", "denoising normal", "vraynormals"),
        *("finalimagemovierenderqueue_worldnormal", "finalimageworldnormal"),
    ),
    "position": ("p", "position", "positions", "pos", "worldposition", "world_position", "pworld"),
    "depth": ("z", "depth", "zdepth", "depth_z", "finalimagemovierenderqueue_worlddepth"),
    "mask": ("mask", "a", "alpha"),
    "material": (
        *("material", "materials", "indexma", "material_index", "materialindex", "material_id"),
    ),
    "surface": ("ng", "geometric_normal", "geometry_normal", "surface_normal"),
    "layer_normal": ("layer_normal", "layernormal"),
    "gain": ("gain",),
    "tangent": ("t", "tangent", "tangents", "dpdu"),
    "colour": ("", "rgba", "rgb", "beauty", "combined", "colour", "color"),
}
"""The layer names that are known, compared in lower case, the first one first. A name found
nowhere as a whole may be the last part of one layer's name ("ViewLayer.Normal")."""

_VECTORS = ("xyz", "rgb")
_SCALARS = ("v", "z", "r", "y")


@dataclass(frozen=True)
class Layers:
    """The channels of a file by all the names that they go by; no pixels.

    Attributes:
        channels: by name; in a multi-part file also as "part.name".
        layers: layer in lower case → last part of the name in lower case → name.
        chosen: what the caller named.
    """

    file: ExrFile
    channels: dict[str, Key]
    layers: dict[str, dict[str, str]]
    chosen: Mapping[str, str]

    @classmethod
    def of(cls, file: ExrFile, chosen: Mapping[str, str] | None) -> Layers:
        unknown = [name for name in chosen or {} if name not in NAMES]
        if unknown:
            raise InputError(f"channels: expected {', '.join(NAMES)}, got {unknown[0]!r}")
        channels = {key: (part, name) for key, part, name in file.keys}
        if len({part for part, _ in channels.values()}) > 1:
            for _, part, name in file.keys:
                channels.setdefault(f"{part}.{name}", (part, name))
        layers: dict[str, dict[str, str]] = {}
        for name in channels:
            layer, _, last = name.lower().rpartition(".")
            layers.setdefault(layer, {}).setdefault(last, name)
        return cls(file, channels, layers, chosen or {})

    @property
    def listing(self) -> str:
        """The channels as `list_channels` names them, for messages."""
        shown = [key for key, _, _ in self.file.keys]
        more = f" and {len(shown) - 40} more" if len(shown) > 40 else ""
        return ", ".join(shown[:40]) + more

    def missing(self, wanted: str, what: str = "normal") -> InputError:
        return InputError(
            f"{self.file.path}: {wanted}, got the channels {self.listing}; name a layer of them "
            f"by `channels`, as {what}=LAYER"
        )

    def vector(self, what: str) -> tuple[Key, ...] | None:
        """The three channels of the layer that was named, else of a known one, else None."""
        if what in self.chosen:
            text = self.chosen[what]
            names = self._listed(what, text) if "," in text else self._vector_in(text.lower())
            if names is None:
                raise self.missing(f"{what}: expected a layer {text!r} with X, Y, Z or R, G, B")
        else:
            names = self._named(what, self._vectors())
        return self._keys(names)

    def bare_vector(self) -> tuple[Key, ...] | None:
        """The channels R, G, B (or X, Y, Z) that are in no layer."""
        return self._keys(self._vector_in(""))

    def scalar(self, what: str) -> tuple[Key, ...] | None:
        """The one channel, likewise."""
        if what in self.chosen:
            text = self.chosen[what]
            names = self._scalars().get(text.lower())
            if names is None:
                raise self.missing(f"{what}: expected a channel {text!r}")
        else:
            names = self._named(what, self._scalars())
        return self._keys(names)

    def _named(
        self, what: str, candidates: Mapping[str, tuple[str, ...]]
    ) -> tuple[str, ...] | None:
        """The candidate with a known name; several by the last part of it are an error."""
        for name in NAMES[what]:
            if name in candidates:
                return candidates[name]
        for name in filter(None, NAMES[what]):
            found = {
                self.channels[names[0]]: layer
                for layer, names in candidates.items()
                if layer.rpartition(".")[2] == name
            }
            if len(found) > 1 and what in ("normal", "depth"):
                several = ", ".join(found.values())
                raise self.missing(f"{what}: expected one layer that may be it, not {several}")
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
        absent = [name for name in names if name not in self.channels]
        if absent or len(names) != 3:
            raise self.missing(f"{what}: expected three channels of the file in {text!r}")
        return names

    def _keys(self, names: tuple[str, ...] | None) -> tuple[Key, ...] | None:
        return None if names is None else tuple(self.channels[name] for name in names)
