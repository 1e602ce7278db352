"""A set of photographs as pixels that a model is compared with, some at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from raden_torch.brdf.materials.surface import Reflection
from raden_torch.capture.photo.capture_normals import LitSet
from raden_torch.capture.photo.colour import ColourCorrection
from raden_torch.stereo.observed_light import ObservedLight, thinned
from raden_torch.stereo.solve import SAMPLE, learnt, residuals, solve_by_model

AT_ONCE = 1 << 17
_BLOCK = 32
_FLOOR = 0.003
"""Of the set's bright values: the standard deviation of a dark one."""
_BRIGHT = 0.95
_BALANCED = 0.02
_SAMPLE = 1 << 14


@dataclass(frozen=True, eq=False)
class Photographed:
    """Photographs of an object.

    Attributes:
        given: as read.
        index: `[P]` numbers in H·W of the object's pixels, block by block: neighbours see nearly
            the same lamps and camera.
        correction: of a camera's colours, where it was measured.
        balance: `[C]`, what each channel is divided by.
        floor: the standard deviation of a dark value.
        is_grey: the photographs have no colour; their mean is compared.
    """

    given: LitSet
    index: Tensor
    correction: ColourCorrection | None
    balance: Tensor
    floor: float
    is_grey: bool

    @classmethod
    def of(cls, given: LitSet, correction: ColourCorrection | None = None) -> Photographed:
        """Of a set that was read."""
        inside = (given.mask_map.reshape(-1) > 0.5).nonzero()[:, 0]
        width = given.photos.size[1]
        row, column = inside // width // _BLOCK, inside % width // _BLOCK
        index = inside[torch.argsort(row * (width // _BLOCK + 1) + column, stable=True)]
        some = thinned(index, _SAMPLE)
        stored = given.photos.images.flatten(2)[:, :, some]
        is_grey = bool((stored == stored[:, :1]).all()) and correction is None
        known = cls(given, index, correction, torch.ones(1 if is_grey else 3), 1.0, is_grey)
        value = known.at(some).value
        bright = float(np.quantile(value.numpy(), _BRIGHT))
        return replace(known, floor=_FLOOR * max(bright, 1e-12))

    @property
    def size(self) -> tuple[int, int]:
        return self.given.photos.size

    @cached_property
    def sample(self) -> ObservedLight:
        """A few thousand pixels, all over the object."""
        return self.at(thinned(self.index, SAMPLE))

    def parts(self) -> Sequence[Tensor]:
        """Numbers of pixels that are worked on at once."""
        return self.index.split(AT_ONCE)

    def at(self, index: Tensor) -> ObservedLight:
        """Pixels by their numbers in H·W."""
        photos, given = self.given.photos, self.given
        count = len(photos.images)
        value = photos.images.flatten(2)[:, :, index].clamp(min=0)
        value = torch.nan_to_num(value, posinf=0.0) ** given.exponent
        if self.correction is not None:
            flat = self.correction.to_linear_srgb(value.movedim(1, -1).numpy())
            value = torch.from_numpy(flat).movedim(-1, 1).clamp(min=0)
        if self.is_grey:
            value = value[:, :1]
        value = value / self.balance[:, None]
        usable = (~photos.saturated.flatten(2)[:, :, index]).to(value.dtype)
        light = given.directions.float()
        light = light[:, :, None] if light.ndim == 2 else light.flatten(2)[:, :, index]
        length = light.norm(dim=1, keepdim=True)
        intensity = given.intensity / given.intensity.mean()
        strength = intensity.view(count, 1, 1)
        if given.directions.ndim == 4:
            strength = strength * length
        view = given.view if given.view.shape[1] == 1 else given.view[:, index]
        return ObservedLight(value, usable, light / length, strength, view, self.floor)

    def balanced(self, materials: Sequence[Reflection]) -> Photographed:
        """With channels as bright as the materials', where the camera's colour was not measured."""
        if self.is_grey or self.correction is not None:
            return self
        found = self
        for _ in range(2):
            light = found.sample
            solved = solve_by_model(materials, light, known=learnt(materials, light))
            radiance, _ = residuals(materials, light, solved)
            used = (light.usable > 0) & (radiance > radiance.median())
            ratio = torch.stack(
                [(light.value[:, c] / radiance[:, c])[used[:, c]].median() for c in range(3)]
            )
            ratio = ratio / ratio.mean()
            if not bool(((ratio - 1).abs() > _BALANCED).any()):
                break
            found = replace(found, balance=found.balance * ratio)
        return found
