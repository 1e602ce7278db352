"""Pictures of a model: a shape, lit, as a file. What `raden render` and `raden demo` share."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from raden_torch.brdf.display import auto_exposure_ev, to_display, write_picture
from raden_torch.brdf.gbuffer_file import GBufferFile, read_gbuffer, write_image
from raden_torch.brdf.image_file import (
    Green,
    read_mask,
    read_normal_map,
    read_photograph,
    write_photograph,
)
from raden_torch.brdf.lights import DirectionalLight, Light, PointLight
from raden_torch.brdf.model import RadenBrdf
from raden_torch.brdf.model_file import load_model
from raden_torch.brdf.plate import plate, shade_plate
from raden_torch.brdf.relight import lamp_ring, relight, relit_strip
from raden_torch.brdf.shade import shade
from raden_torch.brdf.shade_file import shade_file
from raden_torch.brdf.shapes import average_samples, sphere
from raden_torch.errors import InputError
from raden_torch.files import check_writable


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
}


def render_shape(
    model: RadenBrdf,
    shape: str,
    lights: Sequence[Light] | None = None,
    *,
    camera: tuple[float, float, float] | None = None,
    size: int = 512,
    samples: int = 2,
) -> Tensor:
    """`[1, 3, size, size]` scene-linear RGB of a shape, anti-aliased in linear light.

    Args:
        shape: a key of `SHAPES`, which also has the lights and the camera where none are given.
    """
    if shape not in SHAPES:
        raise InputError(f"shape {shape}: {' or '.join(SHAPES)} was wanted")
    view = SHAPES[shape]
    lights, camera = lights or view.lights, camera or view.camera
    with torch.no_grad():
        if shape == "plate":
            image = shade_plate(model, plate(size, camera, samples=samples), lights)
        else:
            image = shade(model, sphere(size, camera, samples=samples), lights)
        return average_samples(image, samples)


def render_gbuffer(
    model: RadenBrdf,
    path: Path,
    lights: Sequence[Light] | None = None,
    *,
    channels: dict[str, str] | None = None,
    fov_deg: float | None = None,
    smooth_px: float = 0.0,
) -> Tensor:
    """`[1, 3, H, W]` scene-linear RGB of an EXR G-buffer; see `gbuffer_file.read_gbuffer`."""
    gbuffer = read_gbuffer(path, channels=channels, fov_deg=fov_deg, smooth_px=smooth_px)
    with torch.no_grad():
        return shade(model, gbuffer, lights or SHAPES["sphere"].lights)


def render_gbuffer_file(
    model: RadenBrdf,
    path: Path,
    output: Path,
    lights: Sequence[Light] | None = None,
    *,
    channels: dict[str, str] | None = None,
    fov_deg: float | None = None,
    smooth_px: float = 0.0,
    exposure_ev: float | None = None,
    memory: int | None = None,
    shown: Callable[[float], object] = lambda share: None,
) -> float:
    """Light an EXR G-buffer of any size into a scene-linear EXR; see `brdf.shade_file`.

    Args:
        memory: bytes to use beside what the program takes; None reads the image at once.
        shown: called with the share of the image that is done.

    Returns:
        The exposure in stops: what was asked for, or 0.
    """
    scene = GBufferFile(
        path, channels=channels, fov_deg=fov_deg, smooth_px=smooth_px, memory=memory
    )
    stops = exposure_ev or 0.0
    lamps = lights or SHAPES["sphere"].lights
    with closing(shade_file(model, scene, lamps, output, gain=2.0**stops)) as bands:
        for rows in bands:
            shown(rows / scene.size[0])
    return stops


def save_picture(
    image: Tensor,
    path: str | os.PathLike[str],
    model: RadenBrdf,
    *,
    exposure_ev: float | None = None,
) -> float:
    """Write a scene-linear image `[1, 3, H, W]`; a simulated specimen is named in the picture.

    An EXR keeps the scene-linear values as they are.

    Returns:
        The exposure in stops: what was asked for, or what was chosen where None.
    """
    if Path(path).suffix.lower() == ".exr":
        write_image(image * 2.0 ** (exposure_ev or 0.0), path)
        return exposure_ev or 0.0
    stops = auto_exposure_ev(image) if exposure_ev is None else exposure_ev
    write_picture(to_display(image, stops)[0], path, caption_of(model))
    return stops


def caption_of(model: RadenBrdf) -> str | None:
    """What a picture of this model has to say of itself."""
    if not model.provenance.simulated:
        return None
    return f"simulated specimen: {model.provenance.sample}"


def relight_files(
    photos: Sequence[Path],
    normals: Path,
    mask: Path | None,
    model: Path,
    output: Path,
    *,
    lights: Sequence[Light] = (),
    strip: int | None = None,
    elevation_deg: float = 40.0,
    green: Green = "opengl",
    fov_deg: float | None = None,
    exposure_ev: float | None = None,
) -> list[Path]:
    """Relight photographs that share a normal map and a mask; returns the files written.

    Args:
        output: the image to write, or a folder (made where missing) for several photographs.
        strip: this many lamps in a ring, side by side, instead of `lights`.
        elevation_deg: the ring's angle above the picture's plane.
        fov_deg: of an EXR that holds depth instead of normals.
        exposure_ev: stops; where None the masked part keeps its mean luminance.
    """
    targets = _targets(photos, output)
    loaded = load_model(model)
    normal = read_normal_map(normals, green, fov_deg=fov_deg)
    coverage = read_mask(mask) if mask else (normal != 0).any(dim=1, keepdim=True).float()
    gain = None if exposure_ev is None else 2.0**exposure_ev
    for path, target in zip(photos, targets, strict=True):
        photo = read_photograph(path)
        with torch.no_grad():
            if strip is None:
                relit = relight(loaded, photo.linear, normal, coverage, lights, gain=gain)
            else:
                lamps = lamp_ring(strip, elevation_deg)
                relit = relit_strip(loaded, photo.linear, normal, coverage, lamps, gain=gain)
        write_photograph(replace(photo, linear=relit), target, caption_of(loaded))
    return targets


def _targets(photos: Sequence[Path], output: Path) -> list[Path]:
    if len(photos) == 1 and not output.is_dir():
        check_writable(output)
        return [output]
    if len({photo.name for photo in photos}) < len(photos):
        raise InputError("photographs of the same name would overwrite each other; rename them")
    if output.suffix and not output.is_dir():
        raise InputError(f"{output}: several photographs need a folder; name one without a suffix")
    output.mkdir(parents=True, exist_ok=True)
    if output.resolve() in {photo.parent.resolve() for photo in photos}:
        raise InputError(f"{output}: the photographs lie there themselves; name another folder")
    return [output / photo.name for photo in photos]
