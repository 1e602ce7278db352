"""Pictures of a model: a shape, lit, as a file. What `raden render` and `raden demo` share."""

from __future__ import annotations

import os
from collections.abc import Sequence

import torch
from torch import Tensor

from raden_torch.brdf.display import auto_exposure_ev, to_display, write_picture
from raden_torch.brdf.lights import Light
from raden_torch.brdf.model import RadenBrdf
from raden_torch.brdf.shade import shade
from raden_torch.brdf.shapes import average_samples, sphere
from raden_torch.errors import InputError

SHAPES = {"sphere": sphere}


def render_shape(
    model: RadenBrdf,
    shape: str,
    lights: Sequence[Light],
    *,
    camera: tuple[float, float, float] = (0.0, 0.0, 6.0),
    size: int = 512,
    samples: int = 2,
) -> Tensor:
    """`[1, 3, size, size]` scene-linear RGB of a shape, anti-aliased in linear light."""
    if shape not in SHAPES:
        raise InputError(f"--shape {shape}: {', '.join(SHAPES)} was wanted")
    gbuffer = SHAPES[shape](size, camera, samples=samples)
    with torch.no_grad():
        return average_samples(shade(model, gbuffer, lights), samples)


def save_picture(
    image: Tensor,
    path: str | os.PathLike[str],
    model: RadenBrdf,
    *,
    exposure_ev: float | None = None,
) -> float:
    """Write a scene-linear image `[1, 3, H, W]`; a simulated specimen is named in the picture.

    Returns:
        The exposure in stops: what was asked for, or what was chosen where None.
    """
    stops = auto_exposure_ev(image) if exposure_ev is None else exposure_ev
    write_picture(to_display(image, stops)[0], path, caption_of(model))
    return stops


def caption_of(model: RadenBrdf) -> str | None:
    """What a picture of this model has to say of itself."""
    if not model.provenance.simulated:
        return None
    return f"simulated specimen: {model.provenance.sample}"
