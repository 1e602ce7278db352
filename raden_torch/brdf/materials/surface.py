"""What a material is told of a surface, and what `shade` asks of a material."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, cast, runtime_checkable

import torch
from torch import Tensor

from raden_torch.geometry import dot


@dataclass(frozen=True, eq=False)
class Surface:
    """Every pixel of a G-buffer as a material sees it: maps of one dtype, on one device.

    Attributes:
        normal, view: `[B, 3, H, W]` (or broadcastable), unit, or zero where invalid.
        layer_normal: of the film layers below the polished surface, unit; None: they lie in it.
        tangent: of the surface, as the G-buffer gives it; None where it has none.
        material: `[B, 1, H, W]` indices or `[B, K, H, W]` weights, as the G-buffer gives them.
    """

    normal: Tensor
    view: Tensor
    layer_normal: Tensor | None = None
    tangent: Tensor | None = None
    material: Tensor | None = None


class Reflection(Protocol):
    """What `shade` needs of a material; `RadenBrdf` is one."""

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        """The dtype to compute in for maps of these dtypes."""

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """f_r in 1/sr of unit (or zero) vectors, 0 below the horizon."""


@runtime_checkable
class SurfaceReflection(Reflection, Protocol):
    """A material that reads more of the surface than its normal."""

    def of_surface(self, surface: Surface, l: Tensor) -> Tensor:  # noqa: E741
        """f_r in 1/sr for unit (or zero) directions to the light, 0 below the horizon."""


def formula_of(material: Reflection) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    """f_r of n, l and v by a material's own formula, where it also has a table."""
    own = getattr(material, "formula", material.of_unit_vectors)
    return cast(Callable[[Tensor, Tensor, Tensor], Tensor], own)


def reflected(material: Reflection, surface: Surface, l: Tensor) -> Tensor:  # noqa: E741
    """f_r of a material, which knows `of_surface` or not: `[B, 3, H, W]` in 1/sr.

    One that does not is its film layers: it turns with `layer_normal`, and is 0 below the horizon
    of the layers or of the surface.
    """
    if isinstance(material, SurfaceReflection):
        return material.of_surface(surface, l)
    n, v, layers = surface.normal, surface.view, surface.layer_normal
    if layers is None:
        return material.of_unit_vectors(n, l, v)
    f = material.of_unit_vectors(layers, l, v)
    return torch.where((dot(n, l) > 0) & (dot(n, v) > 0), f, torch.zeros_like(f))
