"""A material that looks different when it is turned in its own plane: one model an azimuth.

A measurement at several sample azimuths gives f_r(a, r, t; φ). With p along L × V (turned as
`geometry` turns it where a < 0), the direction across the measuring plane's normal in the surface
is x ∝ p × N, from the lamp's side to the viewer's. The sample's azimuth φ is the angle of the
tangent T against it, counter-clockwise seen from above, so

    cos φ ∝ T·(p × N),  sin φ ∝ T·p,

with T's part in the surface. Between the azimuths that were measured f_r is linear in φ.

It is read from one table with a fourth axis, the azimuth (`tables`): two reads a pixel, however
many azimuths there are. `kernel/turned.h` does the same in one pass.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, cast
from weakref import WeakKeyDictionary

import torch
from torch import Tensor, nn

from raden_torch import geometry
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.runtime import RuntimeBrdf
from raden_torch.brdf.materials.surface import Surface
from raden_torch.brdf.model.kernel import asks_for_gradient
from raden_torch.brdf.model.model import RadenBrdf, model_state
from raden_torch.brdf.model.reflectance_table import trilinear
from raden_torch.brdf.model.runtime_bake import bake
from raden_torch.brdf.model.runtime_table import RuntimeLayout, address
from raden_torch.errors import InputError, check_type
from raden_torch.geometry import dot

PERIODS = (180.0, 360.0)
_LEAST_APART_DEG = 0.01


class AnisotropicBrdf(nn.Module):
    """Models of one sample at several azimuths, chosen by `GBuffer.tangent`.

    Without a tangent it is the mean over the azimuths, as an isotropic model has it. A tangent that
    is zero, not finite or parallel to the normal marks an invalid pixel: its value is 0.

    Args:
        models: one for each azimuth.
        azimuth_deg: at which the sample stood, distinct within a period.
        period_deg: 360, or 180 of a sample that half a turn leaves as it is.

    Attributes:
        azimuth_deg: rising, within the period.
        models: in the same order.

    Raises:
        InputError: fewer than two azimuths, not as many models, or two that are one.

    Examples:
        >>> import raden_torch as rt
        >>> shells = [
        ...     rt.fit(rt.simulate_specimen(name, step_deg=35)).model
        ...     for name in ("akoya", "yakogai")
        ... ]
        >>> turned = AnisotropicBrdf(shells, (0, 90), period_deg=180)
        >>> turned.azimuth_deg
        (0.0, 90.0)
    """

    def __init__(
        self,
        models: Sequence[RadenBrdf],
        azimuth_deg: Sequence[float],
        *,
        period_deg: float = 360.0,
    ) -> None:
        super().__init__()
        if period_deg not in PERIODS:
            raise InputError(f"period_deg: expected 180 or 360, got {period_deg}")
        if len(models) < 2 or len(models) != len(azimuth_deg):
            raise InputError(
                "azimuth_deg: expected two or more azimuths, one for each model, got "
                f"{len(azimuth_deg)} for {len(models)}"
            )
        for place, model in enumerate(models):
            check_type(f"models[{place}]", model, RadenBrdf, "fit(…).model is one")
        turned = [float(x) % period_deg for x in azimuth_deg]
        order = sorted(range(len(turned)), key=turned.__getitem__)
        self.azimuth_deg = tuple(turned[i] for i in order)
        self.period_deg = float(period_deg)
        after = (*self.azimuth_deg[1:], self.azimuth_deg[0] + period_deg)
        gaps = (b - a for a, b in zip(self.azimuth_deg, after, strict=True))
        if not all(map(math.isfinite, turned)) or not all(gap >= _LEAST_APART_DEG for gap in gaps):
            raise InputError(
                f"azimuth_deg: expected azimuths that differ within {period_deg:g} degrees, got "
                f"{', '.join(f'{float(x):g}' for x in azimuth_deg)}"
            )
        self.models = nn.ModuleList(models[i] for i in order)

    def __len__(self) -> int:
        return len(self.models)

    def __iter__(self) -> Iterator[RadenBrdf]:
        return iter(cast(Iterator[RadenBrdf], self.models))

    def extra_repr(self) -> str:
        return f"azimuth_deg={self.azimuth_deg}, period_deg={self.period_deg:g}"

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        """float64 where an input or a model is, else float32."""
        return geometry.working_dtype(*maps, *self.parameters())

    @property
    def layout(self) -> RuntimeLayout:
        """The nodes of every table: those of the model that has most."""
        return max((model.layout for model in self), key=lambda layout: layout.nodes)

    def tables(self) -> Tensor:
        """`[K, U, V, W, 3]` f_r in 1/sr: the runtime table of each azimuth, in one piece.

        Made anew where a model has changed, and always with gradients.
        """
        return self._baked()[0]

    def mean(self) -> RuntimeBrdf:
        """The mean over the azimuths: what is seen of it where nothing is known of its turn."""
        return self._baked()[1]

    def _baked(self) -> tuple[Tensor, RuntimeBrdf]:
        if torch.compiler.is_compiling() or any(asks_for_gradient(model) for model in self):
            return self._bake()
        state = tuple(model_state(model) for model in self)
        known = _kept.get(self)
        if known is None or known[0] != state:
            with torch.inference_mode(False), torch.no_grad():
                known = _kept[self] = (state, *self._bake())
        return known[1:]

    def _bake(self) -> tuple[Tensor, RuntimeBrdf]:
        tables = torch.stack([bake(model, self.layout) for model in self])
        return tables, RuntimeBrdf(tables.mean(0), self.layout)

    def upper_bound(self) -> Tensor:
        """`[3]`: what |f_r| of each channel cannot exceed in any geometry, in 1/sr."""
        return self.tables().detach().abs().amax((0, 1, 2, 3))

    def forward(
        self, normal: Tensor, light: Tensor, view: Tensor, tangent: Tensor | None = None
    ) -> Tensor:
        """f_r of each pixel, as `RadenBrdf.forward`.

        Args:
            tangent: `[B, 3, H, W]` direction of azimuth 0, of any length.
        """
        geometry.check_vector_maps(normal=normal, light=light, view=view)
        if tangent is not None:
            geometry.check_vector_maps(normal=normal, tangent=tangent)
        dtype = self.working_dtype(normal, light, view)
        n, l, v = (geometry.normalised(m.to(dtype)) for m in (normal, light, view))  # noqa: E741
        along = None if tangent is None else tangent.to(dtype)
        return self.of_surface(Surface(n, v, tangent=along), l)

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """The mean over the azimuths, `[B, 3, H, W]` in 1/sr."""
        return self.mean().of_unit_vectors(n, l, v)

    def of_surface(self, surface: Surface, l: Tensor) -> Tensor:  # noqa: E741
        """f_r in 1/sr for unit (or zero) directions to the light, 0 below the horizon."""
        v = surface.view
        n = surface.normal if surface.layer_normal is None else surface.layer_normal
        if surface.tangent is None:
            f = self.of_unit_vectors(n, l, v)
        else:
            f = self._turned(n, l, v, surface.tangent)
        if surface.layer_normal is None:
            return f
        above = (dot(surface.normal, l) > 0) & (dot(surface.normal, v) > 0)
        return torch.where(above, f, torch.zeros_like(f))

    def _turned(self, n: Tensor, l: Tensor, v: Tensor, tangent: Tensor) -> Tensor:  # noqa: E741
        tables, shape = self.tables().to(n.dtype), self.layout.shape
        u, across, along, above = address(self.layout.warp, n, l, v)
        azimuth, valid = sample_azimuth(n, l, v, tangent)
        low, high, share = self._between(azimuth)
        u, across, along = (
            (x * (count - 1)).clamp(0, count - 1)
            for x, count in zip((u, (across + 1) / 2, (along + 1) / 2), shape, strict=True)
        )
        flat = tables.flatten(0, 1)  # along u, table after table
        below, beyond = (
            trilinear(flat, table.to(u.dtype) * shape[0] + u, across, along)
            for table in (low, high)
        )
        f = below + share * (beyond - below)
        return torch.where(above & valid, f, torch.zeros_like(f))

    def _between(self, azimuth: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The models below and above an azimuth in radians, by number, and how far it is from the
        lower one to the upper, 0…1; `[B, 1, H, W]` each."""
        period = math.radians(self.period_deg)
        at = torch.remainder(azimuth, period)
        nodes = at.new_tensor([math.radians(x) for x in self.azimuth_deg])
        ends = torch.cat([nodes[-1:] - period, nodes, nodes[:1] + period])
        place = torch.searchsorted(nodes, at.detach().contiguous(), right=True)
        share = (at - ends[place]) / (ends[place + 1] - ends[place])
        count = len(nodes)
        return (place - 1) % count, place % count, share.clamp(0, 1)


_kept: WeakKeyDictionary[AnisotropicBrdf, tuple[Any, Tensor, RuntimeBrdf]] = WeakKeyDictionary()


def takes_tangent(material: Any) -> bool:
    """Whether a material, or a member of a palette, turns with `GBuffer.tangent`."""
    members = material if isinstance(material, Palette) else [material]
    return any(isinstance(member, AnisotropicBrdf) for member in members)


def no_tangent(what: str = "tangent") -> InputError:
    """What to raise where a tangent is given, and no material turns with it."""
    return InputError(
        f"{what}: expected a model of several sample azimuths (`raden fit --by-azimuth`), got one "
        "that knows no azimuth"
    )


_LEAST_ACROSS = 1e-5
"""Sine of tangent and normal below which their angle is rounding."""


def sample_azimuth(
    n: Tensor,
    l: Tensor,  # noqa: E741
    v: Tensor,
    tangent: Tensor,
) -> tuple[Tensor, Tensor]:
    """The sample's azimuth in radians, −π…π, and where the tangent has one, `[B, 1, H, W]` each.

    Args:
        n, l, v: unit vectors, or zero.
        tangent: of any length; its part in the surface counts.

    Where lamp and viewer are one direction, the plane of it and the normal is taken, as in
    `geometry`; where the normal is that direction too, the azimuth is 0.
    """
    t = geometry.normalised(tangent)
    t = t - dot(n, t) * n
    valid = torch.isfinite(t).all(geometry.XYZ_DIM, keepdim=True)
    valid = valid & (geometry.length(t) > _LEAST_ACROSS)
    p = geometry.cross(l, v)
    apart = geometry.length(p) > 4 * torch.finfo(n.dtype).eps
    behind = dot(n, v) < dot(n, l) * dot(l, v)  # a < 0 before p is turned
    p = torch.where(behind, -p, p)
    across = torch.where(apart, geometry.cross(p, n), dot(n, l) * n - l)
    sine = torch.where(apart, dot(t, p), dot(t, geometry.cross(n, across)))
    cosine = dot(t, across)
    none = (sine == 0) & (cosine == 0)
    return torch.atan2(sine, torch.where(none, torch.ones_like(cosine), cosine)), valid
