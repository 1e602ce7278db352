"""Photographs of what is not matt → its normals: `raden capture normals --model`, or without one by
the method "alternating"."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from raden_torch.brdf.files.lit_model import load_lit
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.capture.photo.capture_normals import FoundNormals, LitSet, read_lit_set
from raden_torch.capture.photo.colour import read_colour
from raden_torch.capture.photo.photometric_stereo import SurfaceNormals
from raden_torch.capture.photo.stored_photograph import Coding
from raden_torch.stereo.alternating import Alternated, alternate
from raden_torch.stereo.lamp_assignment import agreement
from raden_torch.stereo.learnt_model import TYPICAL_ALBEDO, albedo_of, learnt_model
from raden_torch.stereo.photographed import Photographed
from raden_torch.stereo.solve import Known, ModelNormals, joined, learnt, solve_by_model


@dataclass(frozen=True)
class ModelOptions:
    """How photographs are compared with a model.

    Attributes:
        model: a model or a palette, each pixel of which shows the member that fits best; None
            finds the material with the normals (`alternating.py`).
        colour: of `raden capture colour`; without it the channels' balance is fitted.
        exponent, plane_z, coded, keep_order: as for `capture_normals`.
    """

    model: Path | None = None
    colour: Path | None = None
    exponent: float | None = None
    plane_z: float = 0.0
    keep_order: bool = False
    coded: Coding = "auto"


@dataclass(frozen=True, eq=False)
class FoundByModel(FoundNormals):
    """The surface; and the material where it was found with the normals and is one."""

    material: RadenBrdf | None


@torch.no_grad()
def capture_model_normals(
    photographs: Sequence[Path],
    lights: Path,
    mask: Path | None,
    options: ModelOptions,
    *,
    progress: Callable[[float], None] | None = None,
) -> FoundByModel:
    """Read photographs, lamps and model, check that they belong together, and solve.

    Args:
        lights: a lights file; photograph k was taken under its lamp k.
        progress: called with the share that is done, 0…1.

    Raises:
        InputError: as for what it is made of; photographs in another order than the lamps.

    Warns:
        UserWarning: photographs that disagree with the others; a material that was not found.
    """
    done = progress or (lambda share: None)
    materials = None if options.model is None else members(load_lit(options.model))
    given = read_lit_set(
        photographs,
        lights,
        mask,
        exponent=options.exponent,
        plane_z=options.plane_z,
        coded=options.coded,
        progress=lambda share: done(0.2 * share),
    )
    correction = None if options.colour is None else read_colour(options.colour)
    seen = Photographed.of(given, correction)
    notes: list[str] = []
    material, scale = None, 1.0  # of the materials, over which the albedo is told
    if materials is None:
        light = seen.sample
        learned = alternate(light, progress=lambda share: done(0.2 + 0.3 * share))
        materials, some, notes = [learned.table.material], learned.found, _doubts(learned)
        albedo = albedo_of(learned.table.values)
        if learned.is_better:
            scale = TYPICAL_ALBEDO / albedo
            material = _as_model(learned, scale, photographs)
        else:
            scale = math.pi / albedo  # over a white matt body
        known = learnt(materials, light)
    else:
        seen = seen.balanced(materials)
        light = seen.sample
        known = learnt(materials, light)
        some = solve_by_model(materials, light, known=known)
    residual, odd = agreement(materials, light, some, photographs, keep_order=options.keep_order)
    notes += odd
    found = solved(seen, materials, known, lambda share: done(0.5 + 0.5 * share))
    for note in notes:
        warnings.warn(note, stacklevel=2)
    surface = as_maps(seen, replace(found, gain=found.gain / scale), residual)
    return FoundByModel(
        surface, given.lamps, given.mask, given.exponent, None, tuple(notes), material
    )


def _doubts(found: Alternated) -> list[str]:
    """What a person should know of a material that was found."""
    notes = []
    if not found.gained:
        notes.append(
            "a BRDF fitted to the normals explains the photographs worse than the body it "
            "began with, which is kept; compare with --method robust"
        )
    elif not found.has_settled:
        notes.append(
            f"normals and material have not settled: they still move by "
            f"{found.moved_deg[-1]:.1f} degrees a turn; more lamps, or a model, would help"
        )
    if not found.is_better:
        notes.append(
            "the material that was found predicts a photograph that is left out hardly better "
            f"than a matt body does (off by {100 * found.left_out:.1f} % of a pixel's mean, "
            f"a matt body by {100 * found.matt_left_out:.1f} %); compare with --method robust"
        )
    return notes


def _as_model(found: Alternated, scale: float, photographs: Sequence[Path]) -> RadenBrdf:
    """Its albedo is an assumption; the photographs tell no more than how it changes."""
    said = {
        "seen": round(found.seen, 4),
        "photographs": [path.name for path in photographs],
        "medium_index": found.table.index,
        "left_out": round(found.left_out, 4),
        "matt_left_out": round(found.matt_left_out, 4),
        "scale": f"an albedo of {TYPICAL_ALBEDO:g} is assumed",
    }
    return learnt_model(found.table.values, scale, "", said, found.box_deg)


def members(model: Reflection) -> list[Reflection]:
    """The materials that a pixel may show."""
    return list(model) if isinstance(model, Palette) else [model]


def solved(
    seen: Photographed,
    materials: Sequence[Reflection],
    known: Known,
    progress: Callable[[float], None],
) -> ModelNormals:
    """All pixels of the object, in the order of `seen.index`, some at a time."""
    parts, found = seen.parts(), []
    for k, index in enumerate(parts):

        def done(share: float, before: int = k) -> None:
            progress((before + share) / len(parts))

        found.append(solve_by_model(materials, seen.at(index), known=known, progress=done))
    return joined(found)


def as_maps(seen: Photographed, found: ModelNormals, residual: Tensor) -> SurfaceNormals:
    """Maps of all pixels; the albedo is the factor on what the model reflects."""

    def whole(values: Tensor) -> Tensor:
        height, width = seen.size
        maps = values.new_zeros(len(values), height * width)
        maps[:, seen.index] = values
        return maps.view(1, len(values), height, width)

    given: LitSet = seen.given
    usable = (~given.photos.saturated).sum(0, keepdim=True).float()
    return SurfaceNormals(
        normal=whole(found.normal),
        albedo=whole(found.gain * seen.balance[:, None]),
        confidence=whole(found.confidence[None]),
        error_deg=whole(found.error_deg[None]),
        lamps_used=usable * (given.mask_map > 0.5),
        lamp_residual=residual,
        intensity=given.intensity / given.intensity.mean(),
    )
