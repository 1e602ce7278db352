"""Photographs, relit, as files: what `raden relight` and `raden demo` share."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, cast

import torch
from torch import Tensor

from raden_torch.brdf.files.caption import caption_of
from raden_torch.brdf.files.display import (
    AS_IT_IS,
    Display,
    key_exposure_ev,
)
from raden_torch.brdf.files.gbuffer_file import read_gbuffer
from raden_torch.brdf.files.gbuffer_reading import USUAL, GBufferReading
from raden_torch.brdf.files.image_file import (
    Photograph,
    check_photograph,
    masked_normals,
    read_mask,
    read_normal_map,
    read_photograph,
    write_photograph,
)
from raden_torch.brdf.files.lit_model import load_lit
from raden_torch.brdf.files.material_map import nothing_to_choose, read_material
from raden_torch.brdf.files.normal_axes import Green, NormalAxes
from raden_torch.brdf.materials.anisotropic import no_tangent, takes_tangent
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.shading.lights import DirectionalLight, Light
from raden_torch.brdf.shading.relight import Gain, relight, relit_under, tiled
from raden_torch.contact_sheet import contact_sheet
from raden_torch.errors import InputError
from raden_torch.files import check_outputs
from raden_torch.geometry import normalised

Layout = Literal["picture", "strip", "sheet"]
"""Of what `relight_files` writes."""


@dataclass(frozen=True)
class CameraRgb:
    """How photographs in a camera's own RGB are read.

    Attributes:
        colour: the file of `raden capture colour` that makes colours of it.
        linear: whole numbers are linear light, as in raw files they always are.
    """

    colour: Path
    linear: bool = False


Coded = Literal["srgb", "linear"] | CameraRgb
"""What whole numbers in photographs are."""


def read_to_relight(path: Path, coded: Coded = "srgb") -> Photograph:
    """A photograph in linear light of sRGB's primaries, with the depth of its file.

    Raises:
        InputError: as for `read_photograph`, `read_linear` and `read_colour`.
    """
    if not isinstance(coded, CameraRgb):
        return read_photograph(path, coded=coded)
    from raden_torch.capture.photo.colour import read_colour
    from raden_torch.capture.photo.photograph import read_linear

    photo = read_linear(path, coded="linear" if coded.linear else "auto")
    rgb = torch.from_numpy(read_colour(coded.colour).to_linear_srgb(photo.linear))
    levels = None if photo.bits is None else 2**photo.bits - 1
    return Photograph(rgb.movedim(-1, 0)[None].contiguous(), levels)


@dataclass(frozen=True)
class Surface:
    """What is relit in a photograph.

    Attributes:
        normal: `[1, 3, H, W]`; coverage: `[1, 1, H, W]`, 0…1.
        material: of a palette, `tangent` of a model of several azimuths, as in `GBuffer`.
        layers: `layer_normal` and gains, as in `GBuffer`, where the normals' EXR has them.
    """

    normal: Tensor
    coverage: Tensor
    material: Tensor | None
    tangent: Tensor | None
    layers: Mapping[str, Tensor] = field(default_factory=dict)

    @classmethod
    def read(
        cls,
        model: Reflection,
        path: Path,
        normals: Path,
        mask: Path | None,
        green: Green = "opengl",
        reading: GBufferReading = USUAL,
    ) -> Surface:
        """Of files, as `relight_files` reads them.

        Args:
            path: of the model, for messages.
        """
        tangent = None
        if reading.tangent is not None:
            if not takes_tangent(model):
                raise no_tangent(f"{path}: tangent")
            tangent = torch.as_tensor(reading.tangent, dtype=torch.float32).view(1, 3, 1, 1)
        xyz = str(NormalAxes.of(reading.xyz, green))
        of_normals = vars(replace(reading, material=None, tangent=None, xyz=xyz))
        layers: dict[str, Tensor] = {}
        if normals.suffix.lower() == ".exr":
            gbuffer = read_gbuffer(normals, **of_normals)
            normal = normalised(masked_normals(gbuffer))
            names = ("layer_normal", "diffuse_gain", "specular_gain")
            layers = {name: m for name in names if (m := getattr(gbuffer, name)) is not None}
        else:
            normal = read_normal_map(normals, **of_normals)
        coverage = read_mask(mask) if mask else (normal != 0).any(dim=1, keepdim=True).float()
        material = _material(model, reading.material, normal, coverage)
        return cls(normal, coverage, material, tangent, layers)


def relight_files(
    photos: Sequence[Path],
    normals: Path,
    mask: Path | None,
    model: Path,
    output: Path,
    lights: Sequence[Light],
    *,
    layout: Layout = "picture",
    green: Green = "opengl",
    reading: GBufferReading = USUAL,
    display: Display = AS_IT_IS,
    original: Path | tuple[float, float, float] | None = None,
    coded: Coded = "srgb",
) -> list[Path]:
    """Relight photographs that share a normal map and a mask; returns the files written.

    Args:
        output: the image to write, or a folder (made where missing) for several photographs.
        lights: directional lights in the normals' frame.
        layout: one "picture" under all lights; or each light by itself, side by side in a "strip",
            or in rows of a "sheet", cut to the mask, each with a dial that shows its lamp, exposed
            for the relit part where the exposure is "auto".
        green, reading: as for `read_normal_map`.
        display: exposure of the relit part in stops, "auto" where it keeps its mean luminance; its
            tone curve, which the photograph has already and an EXR has not; gamut and colour space
            of the file.
        original: the direction to the lamp that the photographs were taken under, or the
            normals.json of `raden capture normals`, which knows it by the photograph's name: keeps
            the photograph's own texture.
        coded: what whole numbers in the photographs are; the pictures are written as sRGB. Raw
            files are linear, and have the colours that they say themselves, or those of a colour
            file.

    Alpha is kept where the output's format has one, but not with a colour file. In a strip every
    lamp has it; a contact sheet is opaque.

    Raises:
        InputError: a picture would be written onto one of the files read; whatever reading raises.
    """
    targets = _targets(photos, output)
    known = original if isinstance(original, Path) else None
    colour = coded.colour if isinstance(coded, CameraRgb) else None
    check_outputs(*targets, inputs=(*photos, normals, mask, model, known, reading.material, colour))
    loaded = load_lit(model)
    surface = Surface.read(loaded, model, normals, mask, green, reading)
    for path, target in zip(photos, targets, strict=True):
        photo = read_to_relight(path, coded)
        check_photograph(photo, target, display)
        before = None if original is None else [original_lamp(original, path)]
        try:
            made = relit_photograph(
                loaded, photo, surface, lights, layout, display, before, path=path, target=target
            )
        except InputError as error:  # of which of several?
            raise InputError(f"{path}: {error}") from None
        write_photograph(made, target, caption_of(loaded), display=display)
    return targets


def relit_photograph(
    model: Reflection,
    photo: Photograph,
    surface: Surface,
    lights: Sequence[Light],
    layout: Layout,
    display: Display,
    original: Sequence[Light] | None,
    *,
    path: Path,
    target: Path,
) -> Photograph:
    """One photograph under new lights, as `relight_files` writes it.

    Args:
        original: the lamp it was taken under, where its texture is kept.
        path, target: its file, and the one that it is going to be.
    """
    is_linear = target.suffix.lower() == ".exr" or photo.levels is None
    shown = replace(display, tone="srgb") if is_linear else display
    relit = _relit(model, photo.linear, surface, lights, layout, shown, original)
    return replace(photo, linear=relit, alpha=_alpha_of(photo, path, layout, len(lights)))


def _material(
    model: Reflection, path: Path | None, normal: Tensor, coverage: Tensor
) -> Tensor | None:
    """What a palette's map says, where there is one."""
    if not isinstance(model, Palette):
        if path is not None:
            raise nothing_to_choose(path)
        return None
    if path is None:
        if len(model) == 1:
            return None
        raise InputError(
            f"material: expected a map that says which of {', '.join(model.names)} each pixel "
            "shows, got none; give `material`"
        )
    size = cast(tuple[int, int], tuple(normal.shape[2:]))
    fits = coverage.shape[2:] == normal.shape[2:]  # else it is refused with the photograph's size
    return read_material(path, model, size, coverage if fits else None)


def _relit(
    model: Reflection,
    photo: Tensor,
    surface: Surface,
    lights: Sequence[Light],
    layout: Layout,
    display: Display,
    original: Sequence[Light] | None,
) -> Tensor:
    """`[1, 3, …]`."""
    gain: Gain | None = 2.0**display.linear_stops
    if isinstance(display.exposure, str):
        gain = None if display.exposure == "auto" else _gain_by_key
    chosen: dict[str, Any] = {
        "gain": gain,
        "original": original,
        "material": surface.material,
        "tangent": surface.tangent,
        "layers": surface.layers,
        "curve": display.curved,
    }
    scene = (model, photo, surface.normal, surface.coverage, lights)
    with torch.no_grad():
        if layout == "picture":
            return relight(*scene, **chosen)
        tiles = relit_under(*scene, **chosen)
        if layout == "strip":
            return tiled(tiles, len(lights))
        # lamps of another kind were refused: they need positions
        lamps = cast(Sequence[DirectionalLight], lights)
        return contact_sheet(tiles, surface.coverage, lamps, exposed=display.exposure == "auto")


def _gain_by_key(lit: Tensor, mask: Tensor) -> float:
    return 2.0 ** key_exposure_ev(lit * mask)


def _alpha_of(photo: Photograph, path: Path, layout: Layout, lamps: int) -> Tensor | None:
    """The photograph's own, once a lamp in a strip; a contact sheet is opaque."""
    if photo.alpha is None or layout == "picture":
        return photo.alpha
    if layout == "strip":
        return photo.alpha.repeat(1, 1, 1, lamps)
    if bool((photo.alpha < 1).any()):
        warnings.warn(f"{path}: alpha is left out: a contact sheet is opaque", stacklevel=3)
    return None


def original_lamp(
    original: Path | tuple[float, float, float], photograph: Path
) -> DirectionalLight:
    """The lamp that a photograph was taken under."""
    if not isinstance(original, Path):
        return DirectionalLight(original)
    from raden_torch.capture.photo.normals_file import KIND, NormalsFile
    from raden_torch.capture.photo.result_file import read_result

    for lamp in read_result(original, KIND, NormalsFile).lamps:
        if lamp.photograph == photograph.name:
            try:
                return DirectionalLight(lamp.direction_to_lamp)
            except InputError as error:
                raise InputError(f"{original}: {error}") from None
    raise InputError(
        f"{original}: expected one of its photographs, got {photograph.name}; give the lamp as "
        "x,y,z"
    )


def _targets(photos: Sequence[Path], output: Path) -> list[Path]:
    if len(photos) == 1 and not output.is_dir():
        return [output]
    if len({photo.name for photo in photos}) < len(photos):
        raise InputError("photographs: expected different names, got one twice; rename them")
    if output.suffix and not output.is_dir():
        raise InputError(
            f"{output}: expected a folder (no suffix) for several photographs, got a file"
        )
    output.mkdir(parents=True, exist_ok=True)
    if output.resolve() in {photo.parent.resolve() for photo in photos}:
        raise InputError(f"{output}: expected another folder than the photographs' own, got that")
    return [output / photo.name for photo in photos]
