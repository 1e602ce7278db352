"""Pictures of a model: a shape, lit, as a file. What `raden render` and `raden demo` share."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from raden_torch.artwork.board import CAMERA as BOARD_CAMERA
from raden_torch.artwork.board import broad_light, shade_materials
from raden_torch.artwork.plate import plate, shade_plate
from raden_torch.brdf.files.caption import caption_of
from raden_torch.brdf.files.display import AS_IT_IS, Display
from raden_torch.brdf.files.gbuffer_file import GBufferFile, read_gbuffer
from raden_torch.brdf.files.gbuffer_reading import USUAL, GBufferReading
from raden_torch.brdf.files.lit_model import load_lit
from raden_torch.brdf.files.shade_file import Shadowed, shade_file
from raden_torch.brdf.materials.anisotropic import no_tangent, takes_tangent
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.pearl import PEARL, is_pearl, pearl
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import DirectionalLight, Light, PointLight
from raden_torch.brdf.shading.radiance_std import RadianceStd
from raden_torch.brdf.shading.shade import shade, warn_if_black
from raden_torch.brdf.shading.sphere_gbuffer import average_samples, sphere
from raden_torch.brdf.shading.triples import Triple, as_map, check_direction
from raden_torch.errors import InputError


@dataclass(frozen=True)
class View:
    """How a shape is shown unless one says otherwise."""

    camera: tuple[float, float, float]
    lights: tuple[Light, ...]


SHAPES = {
    "sphere": View((0.0, 0.0, 6.0), (DirectionalLight((1.0, 1.0, 2.0)),)),
    "plate": View(
        (0.0, -2.4, 4.2),
        (PointLight((-0.7, 1.1, 2.6)), PointLight((1.6, 0.7, 2.2), (1.6, 1.6, 1.6))),
    ),
    "board": View(BOARD_CAMERA, tuple(broad_light())),
}


def render_shape(
    model: Reflection,
    shape: str,
    lights: Sequence[Light] | None = None,
    *,
    camera: tuple[float, float, float] | None = None,
    tangent: Triple | None = None,
    size: int = 512,
    samples: int = 2,
) -> Tensor:
    """`[1, 3, size, size]` scene-linear RGB of a shape, anti-aliased in linear light.

    A palette shows all of its materials: on the sphere in sectors, clockwise from the top; on the
    plate piece by piece in turn; on the board, whose height is its own, each in the whole motif.

    Args:
        shape: a key of `SHAPES`, which also has the lights and the camera where none are given.
        tangent: the direction of azimuth 0 of a model of several; its part in the surface counts.
    """
    if shape not in SHAPES:
        raise InputError(f"shape: expected {', '.join(SHAPES)}, got {shape}")
    if is_pearl(model) and shape != "sphere":
        raise InputError(f"shape: expected sphere for a pearl, got {shape}")
    _check_tangent(model, shape, tangent)
    view = SHAPES[shape]
    lights, camera = lights or view.lights, camera or view.camera
    with torch.no_grad():
        if shape == "plate":
            made = plate(size, camera, samples=samples)
            made = replace(made, shell=_with_tangent(made.shell, tangent))
            image = shade_plate(model, made, lights)
        elif shape == "board":
            members = model if isinstance(model, Palette) else Palette([model])
            image = shade_materials(members, lights, size, camera=camera, samples=samples)
            samples = 1
        else:
            ball = _with_tangent(sphere(size, camera, samples=samples), tangent)
            if isinstance(model, Palette):
                ball = replace(ball, material=_sectors(size * samples, len(model)))
            image = shade(model, ball, lights)
    warn_if_black(image, lights)
    return average_samples(image, samples)


def sphere_with_std(
    model: Reflection,
    lights: Sequence[Light] | None = None,
    *,
    camera: tuple[float, float, float] | None = None,
    size: int = 512,
    samples: int = 2,
) -> tuple[Tensor, RadianceStd]:
    """`render_shape` of a sphere, and its standard deviations: those of a pixel's rays are means,
    since the rays read the same cells.

    Raises:
        InputError: as `shade` with `return_std`.
    """
    view = SHAPES["sphere"]
    lights = lights or view.lights
    ball = sphere(size, camera or view.camera, samples=samples)
    with torch.no_grad():
        image, std = shade(model, ball, lights, return_std=True)
    warn_if_black(image, lights)
    image, own, systematic = (average_samples(x, samples) for x in (image, std.own, std.systematic))
    return image, RadianceStd(own, systematic)


def _check_tangent(model: Reflection, shape: str, tangent: Triple | None) -> None:
    if tangent is None:
        return
    check_direction("tangent", tangent)
    if not takes_tangent(model):
        raise no_tangent()
    if shape == "board":
        raise InputError("shape: expected sphere or plate with a tangent, got board")


def _with_tangent(gbuffer: GBuffer, tangent: Triple | None) -> GBuffer:
    if tangent is None:
        return gbuffer
    return replace(gbuffer, tangent=as_map(tangent, gbuffer.normal))


def _sectors(size: int, count: int) -> Tensor:
    """`[1, 1, size, size]`: the number of each pixel's sector around the middle."""
    across = torch.linspace(-1, 1, size)
    turn = torch.atan2(across, -across[:, None]) / (2 * torch.pi) % 1  # 0 at the top
    return (turn * count).long().clamp(max=count - 1)[None, None]


def render_gbuffer(
    model: Reflection,
    path: Path,
    lights: Sequence[Light] | None = None,
    reading: GBufferReading = USUAL,
    *,
    tolerance: float = 0.0,
    shadowed: Shadowed | None = None,
) -> Tensor:
    """`[1, 3, H, W]` scene-linear RGB of an EXR G-buffer; see `read_gbuffer` and `shade`.

    Args:
        shadowed: gives the lights their shadows, as `with_screen_shadows`.
    """
    gbuffer, lights = _read_scene(model, path, lights, reading, shadowed)
    with torch.no_grad():
        image = shade(model, gbuffer, lights, tolerance=tolerance)
    warn_if_black(image, lights)
    return image


def gbuffer_with_std(
    model: Reflection,
    path: Path,
    lights: Sequence[Light] | None = None,
    reading: GBufferReading = USUAL,
    *,
    shadowed: Shadowed | None = None,
) -> tuple[Tensor, RadianceStd]:
    """`render_gbuffer`, and the image's standard deviations.

    Raises:
        InputError: as `shade` with `return_std`.
    """
    gbuffer, lights = _read_scene(model, path, lights, reading, shadowed)
    with torch.no_grad():
        image, std = shade(model, gbuffer, lights, return_std=True)
    warn_if_black(image, lights)
    return image, std


def _read_scene(
    model: Reflection,
    path: Path,
    lights: Sequence[Light] | None,
    reading: GBufferReading,
    shadowed: Shadowed | None,
) -> tuple[GBuffer, Sequence[Light]]:
    gbuffer = read_gbuffer(
        path, palette=_palette(model), turns=takes_tangent(model), **vars(reading)
    )
    lights = lights or SHAPES["sphere"].lights
    return gbuffer, lights if shadowed is None else shadowed(gbuffer, lights)


def _palette(model: Reflection) -> Palette | None:
    return model if isinstance(model, Palette) else None


def render_gbuffer_file(
    model: Reflection,
    path: Path,
    output: Path,
    lights: Sequence[Light] | None = None,
    reading: GBufferReading = USUAL,
    *,
    display: Display = AS_IT_IS,
    tolerance: float = 0.0,
    memory: int | None = None,
    shadowed: Shadowed | None = None,
    shown: Callable[[float], object] = lambda share: None,
) -> float:
    """Light an EXR G-buffer of any size into a scene-linear EXR; see `brdf.files.shade_file`.

    Args:
        tolerance: as for `shade`.
        memory: bytes to use beside what the program takes; None reads the image at once.
        shadowed: gives the lights their shadows; only for an image that is read at once.
        shown: called with the share of the image that is done.

    Returns:
        The exposure in stops: what was asked for, or 0.
    """
    scene = GBufferFile(
        path, reading, memory=memory, palette=_palette(model), turns=takes_tangent(model)
    )
    lamps = lights or SHAPES["sphere"].lights
    shaded = shade_file(
        model, scene, lamps, output, display=display, tolerance=tolerance, shadowed=shadowed
    )
    with closing(shaded) as bands:
        for rows in bands:
            shown(rows / scene.size[0])
    return display.linear_stops


def save_picture(
    image: Tensor,
    path: str | os.PathLike[str],
    model: Reflection,
    *,
    display: Display = AS_IT_IS,
) -> float:
    """Write a scene-linear image `[1, 3, H, W]`; a simulated specimen is named in the picture.

    An EXR keeps the scene-linear values as they are, but for stops that are asked for.

    Returns:
        The exposure in stops.
    """
    return display.write(image, path, caption_of(model))


def load_material(
    model: Path, illuminant: str | None = None, white: str | None = None
) -> Reflection:
    """The material of a file, or "pearl": a simulated one, where there is no file of that name.

    Args:
        illuminant, white: of a spectral model; see `load_lit`.
    """
    if str(model) != PEARL or model.exists():
        return load_lit(model, illuminant, white)
    if illuminant is not None or white is not None:
        raise InputError("`illuminant`: expected with a spectral model, got the pearl, in RGB")
    return pearl()
