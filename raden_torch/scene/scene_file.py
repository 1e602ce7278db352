"""What a scene file holds: a TOML file, its tables and their keys (docs/scenes.md)."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from raden_torch.schema import (
    Finite,
    NotNegative,
    Positive,
    Text,
    Triple,
    checked,
    read_document,
)

Share = Annotated[float, Meta(ge=0, le=1)]
Colour = tuple[NotNegative, NotNegative, NotNegative]
Albedo = tuple[Share, Share, Share]
Pixels = Annotated[int, Meta(ge=1, le=16384)]
Frame = Annotated[int, Meta(ge=1, le=100_000)]
Roughness = Annotated[float, Meta(gt=0, le=1)]
Polish = Annotated[float, Meta(gt=0, le=0.2)]
Seed = Annotated[int, Meta(ge=0, le=2**31)]


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A table of the file: other keys are refused."""


class PictureTable(_Table, frozen=True):
    """The picture; `samples` along each side of a pixel at edges."""

    size: tuple[Pixels, Pixels] = (1280, 720)
    samples: Annotated[int, Meta(ge=1, le=16)] = 3


class CameraTable(_Table, frozen=True):
    """A pinhole camera; over the animation it turns about its target."""

    position: Triple
    target: Triple = (0.0, 0.0, 0.0)
    fov_deg: Annotated[float, Meta(gt=0, lt=180)] = 33.0
    turn_deg: Finite = 0.0
    swing_deg: Finite = 0.0


class ObjectTable(_Table, frozen=True):
    """What is shown: a box, or the surface in an EXR G-buffer."""

    gbuffer: Text | None = None
    fov_deg: Annotated[float, Meta(gt=0, lt=180)] | None = None
    size: tuple[Positive, Positive, Positive] = (2.8, 0.78, 2.0)
    rounding: Positive = 0.075
    dome: Annotated[float, Meta(ge=0, le=0.5)] = 0.055
    artwork: Literal["makie", "none"] | None = None
    seed: Seed = 7
    ground: Text = "black"
    turn_deg: Finite = 0.0
    swing_deg: Finite = 0.0
    table: Albedo | Literal["none"] = (0.42, 0.405, 0.385)
    table_roughness: Polish | None = None


class MaterialTable(_Table, frozen=True):
    """A material: one of model, shell, urushi, metal and albedo says what it is."""

    name: Text
    model: Text | None = None
    shell: Text | None = None
    tablets: list[Annotated[float, Meta(ge=0.7, le=1.4)]] | None = None
    urushi: Literal["black", "vermilion"] | None = None
    metal: Literal["gold", "silver"] | None = None
    albedo: Albedo | None = None
    roughness: Roughness | None = None


class LayerTable(_Table, frozen=True):
    """Where a material is: a mask, from a file; the first layer is on top."""

    material: Text
    mask: Text
    normal: Text | None = None


class EnvironmentTable(_Table, frozen=True):
    """What surrounds the scene: a file, or the built-in room."""

    file: Text | None = None
    builtin: Literal["room"] | None = None
    rotation_deg: Finite = 0.0
    intensity: NotNegative = 1.0
    turn_deg: Finite = 0.0


class DirectionalTable(_Table, frozen=True):
    """A lamp at infinity."""

    direction: Triple
    irradiance: Colour = (3.14159, 3.14159, 3.14159)


class OrbitTable(_Table, frozen=True):
    """A circle about the vertical through a centre, `turns` times over the animation."""

    centre: Triple = (0.0, 0.0, 0.0)
    turns: Finite = 1.0


class KeyframeTable(_Table, frozen=True):
    """Where a lamp is in a frame; straight between two."""

    frame: Frame
    position: Triple


class PointTable(_Table, frozen=True):
    """A small lamp, which may move."""

    position: Triple = (0.0, 3.0, 0.0)
    intensity: Colour = (3.14159, 3.14159, 3.14159)
    orbit: OrbitTable | None = None
    keyframes: list[KeyframeTable] = []


class RectangleTable(_Table, frozen=True):
    """A lamp with an area; it shines to the side that across × up points to."""

    position: Triple
    across: Triple
    up: Triple
    radiance: Colour = (1.0, 1.0, 1.0)


class LightsTable(_Table, frozen=True):
    """All that shines."""

    environment: EnvironmentTable | None = None
    directional: list[DirectionalTable] = []
    point: list[PointTable] = []
    rectangle: list[RectangleTable] = []


class DisplayTable(_Table, frozen=True):
    """How light becomes a picture: the fields of `Display`."""

    exposure: Finite | Literal["auto", "key"] = "auto"
    tone: Literal["srgb", "neutral", "aces"] = "neutral"
    gamut: Literal["hue", "clip"] = "hue"
    colour_space: Literal["srgb", "display-p3", "acescg"] = "srgb"


class AnimationTable(_Table, frozen=True):
    """How many frames there are, and how many a second."""

    frames: Frame = 48
    fps: Annotated[float, Meta(gt=0, le=240)] = 24.0


class SceneTable(_Table, frozen=True):
    """A scene file."""

    camera: CameraTable | None = None
    picture: PictureTable = PictureTable()
    object: ObjectTable = ObjectTable()
    materials: list[MaterialTable] = []
    layers: list[LayerTable] = []
    lights: LightsTable = LightsTable()
    display: DisplayTable = DisplayTable()
    animation: AnimationTable = AnimationTable()


def read_scene(path: str | os.PathLike[str]) -> SceneTable:
    """Read a scene file and check each key by itself; `scene.Scene` checks what they say together.

    Raises:
        InputError: no TOML, an unknown key (with the nearest known one), a value out of range.
    """
    path = Path(path)
    document = read_document(path, "a scene file", tomllib.loads, most_bytes=1_000_000)
    return checked(document, SceneTable, str(path))


def files_of(scene: SceneTable, folder: Path) -> list[Path]:
    """The files that a scene reads; relative paths start at its folder."""
    around = scene.lights.environment
    named = [
        scene.object.gbuffer,
        around.file if around else None,
        *(m.model for m in scene.materials),
        *(text for layer in scene.layers for text in (layer.mask, layer.normal)),
    ]
    return [folder / text for text in named if text is not None]
