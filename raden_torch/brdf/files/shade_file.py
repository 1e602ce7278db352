"""Shading images that are larger than the memory: an EXR G-buffer becomes an EXR, band by band."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Sequence

import torch

from raden_torch.brdf.files.display import AS_IT_IS, Display
from raden_torch.brdf.files.exr_tensors import in_halves
from raden_torch.brdf.files.gbuffer_file import GBufferFile, has_pixels
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import Light
from raden_torch.brdf.shading.shade import shade, warn_if_black
from raden_torch.errors import InputError
from raden_torch.images.exr import rows_written

Shadowed = Callable[[GBuffer, Sequence[Light]], Sequence[Light]]
"""Lights with the shadows that a G-buffer casts, as `with_screen_shadows` makes them."""


def shade_file(
    model: Reflection,
    scene: GBufferFile,
    lights: Sequence[Light] | Light,
    output: str | os.PathLike[str],
    *,
    display: Display = AS_IT_IS,
    tolerance: float = 0.0,
    shadowed: Shadowed | None = None,
) -> Generator[int, None, None]:
    """Shade a file's bands one after the other; the image is the one that `shade` makes at once.

    Args:
        model, lights, tolerance: as for `shade`.
        scene: the G-buffer; its `bands` decide how much memory is taken.
        output: the scene-linear EXR to write, in half floats.
        display: whose stops and colour space the EXR has.
        shadowed: gives the lights their shadows, which need the file in one band.

    Yields:
        The rows that are done. `output` appears after the last of them; where the loop is left
        before, by an error or Ctrl-C, it is as it was.

    Raises:
        InputError: as for `read_gbuffer` and `shade`.
    """
    if shadowed is not None and len(scene.bands) > 1:
        raise InputError(
            f"{scene.path}: shadows: expected an image that is read at once, got "
            f"{len(scene.bands)} bands, which do not see what is beside them; allow more memory"
        )
    lights = [lights] if isinstance(lights, Light) else list(lights)
    some = lit = False
    with rows_written(output, scene.size, display.chromaticities) as write:
        for top, bottom in scene.bands:
            gbuffer = scene.rows(top, bottom)
            some = some or has_pixels(gbuffer)
            with torch.no_grad():
                here = lights if shadowed is None else shadowed(gbuffer, lights)
                image = shade(model, gbuffer, here, tolerance=tolerance)
            lit = lit or bool((image != 0).any())
            write(in_halves(display.linear(image)))
            del gbuffer, image, here  # before the next band is read
            yield bottom
        if not some:
            raise scene.is_empty()
    if not lit:
        warn_if_black(torch.zeros(1), lights)
