"""A material that looks different when it is turned in its own plane: one model an azimuth.

A measurement at several sample azimuths gives f_r(a, r, t; φ). With p along L × V (turned as
`geometry` turns it where a < 0), the direction across the measuring plane's normal in the surface
is x ∝ p × N, from the lamp's side to the viewer's. The sample's azimuth φ is the angle of the
tangent T against it, counter-clockwise seen from above, so

    cos φ ∝ T·(p × N),  sin φ ∝ T·p,

with T's part in the surface. Between the azimuths that were measured f_r is linear in φ.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor, nn

from raden_torch import geometry
from raden_torch.brdf.materials.surface import Surface, reflected
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.errors import InputError
from raden_torch.geometry import dot

PERIODS = (180.0, 360.0)


class AnisotropicBrdf(nn.Module):
    """Models of one sample at several azimuths, chosen by `GBuffer.tangent`.

    Without a tangent it is the mean over the azimuths, as an isotropic model has it. A tangent that
    is zero, not finite or parallel to the normal marks an invalid pixel: its value is 0. It is
    evaluated in torch, each model by its own fastest form; the fused frame does not take it.

    Args:
        models: one for each azimuth.
        azimuth_deg: at which the sample stood, distinct within a period.
        period_deg: 360, or 180 of a sample that half a turn leaves as it is.

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
        turned = [float(x) % period_deg for x in azimuth_deg]
        order = sorted(range(len(turned)), key=turned.__getitem__)
        self.azimuth_deg = tuple(turned[i] for i in order)
        self.period_deg = period_deg
        if not all(math.isfinite(x) for x in turned) or len(set(turned)) < len(turned):
            raise InputError(
                f"azimuth_deg: expected azimuths that differ within {period_deg:g} degrees, got "
                f"{', '.join(f'{float(x):g}' for x in azimuth_deg)}"
            )
        self.models = nn.ModuleList(models[i] for i in order)

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        """float64 where an input or a model is, else float32."""
        return geometry.working_dtype(*maps, *self.parameters())

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
        return self.of_surface(Surface(n, v), l)

    def of_surface(self, surface: Surface, l: Tensor) -> Tensor:  # noqa: E741
        """f_r in 1/sr for unit (or zero) directions to the light, 0 below the horizon."""
        v = surface.view
        n = surface.normal if surface.layer_normal is None else surface.layer_normal
        parts = [reflected(cast(RadenBrdf, model), surface, l) for model in self.models]
        if surface.tangent is None:
            return torch.stack(parts).mean(0)
        shares = self._shares(n, l, v, surface.tangent)
        return torch.stack([s * part for s, part in zip(shares, parts, strict=True)]).sum(0)

    def _shares(self, n: Tensor, l: Tensor, v: Tensor, tangent: Tensor) -> list[Tensor]:  # noqa: E741
        """`[B, 1, H, W]` for each azimuth; they sum to 1, or to 0 where the tangent is invalid."""
        azimuth, valid = sample_azimuth(n, l, v, tangent)
        at = torch.remainder(azimuth, math.radians(self.period_deg))
        period = math.radians(self.period_deg)
        nodes = [math.radians(x) for x in self.azimuth_deg]
        shares = [torch.zeros_like(at) for _ in nodes]
        for k, low in enumerate(nodes):
            high = nodes[k + 1] if k + 1 < len(nodes) else nodes[0] + period
            from_low = torch.remainder(at - low, period)
            part = from_low / (high - low)
            inside = valid & (from_low < high - low)
            after = (k + 1) % len(nodes)
            shares[k] = shares[k] + torch.where(inside, 1 - part, torch.zeros_like(part))
            shares[after] = shares[after] + torch.where(inside, part, torch.zeros_like(part))
        return shares


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
