"""The runtime form of a material: its formula baked into one table, as `RadenBrdf` is read.

A material whose layers lie in the surface knows only the three angles, so the table of
`model/runtime_table.py` holds it, and the fused kernels read it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor, nn

from raden_torch import geometry
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model import kernel
from raden_torch.brdf.model.balance import balanced
from raden_torch.brdf.model.model import Provenance, RadenBrdf, model_state
from raden_torch.brdf.model.runtime_table import (
    RuntimeLayout,
    address_of_angles,
    angles_of,
    read,
    read_at,
)
from raden_torch.colorimetry import SRGB_LUMINANCE
from raden_torch.errors import InputError

LEAST_BAKED = 0.03
"""The smoothest lobe, as GGX α, that a table holds; a smoother one is computed by its formula."""

Formula = Callable[[Tensor, Tensor, Tensor], Tensor]
"""f_r `[B, 3, H, W]` in 1/sr of n, l, v, unit and above the horizon."""


class RuntimeBrdf(nn.Module):
    """A runtime table without a fit form: what `shade` reads of a baked material.

    To the fused kernels it is a `RadenBrdf` that has no other parts.

    Attributes:
        layout: the nodes of the table.
        values: `[U, V, W, 3]` f_r in 1/sr.
        provenance: of the measurement that it was made of, where there is one.
    """

    values: Tensor
    table = None
    diffuse_gain = specular_gain = 1.0

    def __init__(
        self, values: Tensor, layout: RuntimeLayout, provenance: Provenance | None = None
    ) -> None:
        super().__init__()
        self.layout = layout
        self.provenance = provenance
        self.register_buffer("values", values)

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """`[B, 3, H, W]` f_r in 1/sr of unit (or zero) vectors; 0 below the horizon."""
        if kernel.takes_tensors(n, l, v, self.values):
            return kernel.brdf(self.values, self.layout.warp, n, l, v)
        return read(self.values.to(n.dtype), self.layout.warp, n, l, v)

    @property
    def measured_box_deg(self) -> tuple[tuple[float, float], ...]:
        """As of a `RadenBrdf`; empty where it was made of no measurement."""
        box = self.provenance.fit.get("box_deg", ()) if self.provenance else ()
        return tuple((float(low), float(high)) for low, high in box)

    def runtime_table(self) -> Tensor:
        """`values`."""
        return self.values

    def runtime_brdf(self) -> RuntimeBrdf:
        """Itself: it is all that the fused kernels need."""
        return self

    def upper_bound(self) -> Tensor:
        """`[3]`: what |f_r| of each channel cannot exceed in any geometry, in 1/sr."""
        return self.values.detach().abs().amax((0, 1, 2))

    def at_angles(self, incidence: Tensor, receiving: Tensor, tilt: Tensor) -> Tensor:
        """The same by angles, `[..., 1, H, W]` in radians each → `[..., 3, H, W]`."""
        angles = torch.broadcast_tensors(incidence, receiving, tilt)
        values = self.values.to(angles[0].dtype)
        return read_at(values, *address_of_angles(self.layout.warp, *angles))

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        return geometry.working_dtype(*maps, self.values)


def state_of(material: Reflection) -> Any:
    """What differs whenever a material's reflection does."""
    if isinstance(material, RadenBrdf):
        return id(material), model_state(material)
    state = getattr(material, "state", None)
    return id(material) if state is None else (id(material), state())


_kept: WeakKeyDictionary[Any, dict[str, tuple[Any, RuntimeBrdf]]] = WeakKeyDictionary()


def kept(material: Any, name: str, state: Any, make: Callable[[], RuntimeBrdf]) -> RuntimeBrdf:
    """A material's table, made anew where its state has changed, and always with gradients."""
    own = _kept.setdefault(material, {})
    known = own.get(name)
    if known is not None and known[0] == state and not _recorded(material):
        return known[1]
    if _recorded(material):
        return make()
    with torch.inference_mode(False), torch.no_grad():
        made = make()
    own[name] = (state, made)
    return made


def parameters_of(material: Any) -> list[Tensor]:
    """The parameters of a material and of the bases below it."""
    if isinstance(material, nn.Module):
        return list(material.parameters())
    return [p for part in parts_of(material) for p in parameters_of(part)]


def parts_of(material: Any) -> list[Any]:
    """What a material is made of, one step down: the base of a coat, flakes and ground."""
    parts = (getattr(material, name, None) for name in ("base", "ground", "flakes"))
    return [part for part in parts if part is not None]


def models_of(material: Any) -> list[Any]:
    """The measured or simulated models that a material, or the members of a palette, are made of;
    each once: what has a `provenance`."""
    if getattr(material, "provenance", None) is not None:
        return [material]
    members = list(material) if isinstance(material, Iterable) else []
    found = [m for part in (*parts_of(material), *members) for m in models_of(part)]
    return list({id(model): model for model in found}.values())


def _recorded(material: Any) -> bool:
    return torch.is_grad_enabled() and any(p.requires_grad for p in parameters_of(material))


def least_roughness(material: Any) -> float:
    """The smallest GGX α in a material and its parts; 0.07 where none has one."""
    own = getattr(material, "roughness", None)
    found = [least_roughness(part) for part in parts_of(material)]
    return min([*found, float(own)] if own is not None else found or [0.07])


def layout_for(roughness: float) -> RuntimeLayout:
    """Nodes for what has a lobe of this GGX α: closer to the highlight, the narrower it is.

    Many along u and v, since Fresnel's reflectance and a lobe are steep at grazing angles.
    """
    closer = min(1.0, max(0.3, roughness / 0.07))
    return RuntimeLayout((40, 73, 51), (0.5 * closer, 0.35 * closer))


def like_of(material: Any) -> Tensor:
    """A tensor of the dtype and on the device that a material's table has."""
    like = next(iter(parameters_of(material)), torch.zeros((), device="cpu")).detach()
    return like.to(material.working_dtype(like))


def baked(material: Any, formula: Formula, layout: RuntimeLayout) -> RuntimeBrdf:
    """A formula of a material, or of some of it, as a table."""
    return runtime_brdf(formula, like_of(material), layout)


def runtime_brdf(formula: Formula, like: Tensor, layout: RuntimeLayout) -> RuntimeBrdf:
    """A formula of the three angles as a table.

    Args:
        like: a tensor of the dtype and on the device that it is computed in.

    Raises:
        InputError: the formula is not finite.
    """
    u, v, w = (
        torch.linspace(low, 1, count, dtype=torch.float64, device=like.device)
        for low, count in zip((0.0, -1.0, -1.0), layout.shape, strict=True)
    )
    # where light and view both graze a lobe is infinite: these ends hold what is half a node
    # before, and so do those of v where the two are one direction
    ends = (1 - step / (len(axis) - 1) for axis, step in ((u, 0.5), (v, 1.0), (w, 1.0)))
    at_u, at_v, at_w = (axis.clamp(-end, end) for axis, end in zip((u, v, w), ends, strict=True))
    v = v.expand(len(u), -1).clone()
    v[0] = at_v
    angles = angles_of(layout.warp, at_u[:, None, None], v[..., None], at_w)
    at = (a.to(like.dtype).reshape(1, 1, -1, layout.shape[2]) for a in angles)
    f = formula(*geometry.vectors_from_angles(*at))
    values = f[0].permute(1, 2, 0).reshape(*layout.shape, 3)
    if not bool(torch.isfinite(values.detach()).all()):
        raise InputError("material: expected a finite f_r in every geometry, got one that is not")
    made = RuntimeBrdf(balanced(values).contiguous(), layout)
    for _ in range(2):  # the second time for what the first left between its knots
        made = RuntimeBrdf(_bounded(made, angles), layout)
    return made


_KNOTS_DEG = (0.0, 4.0, 8.0, 15.0, 30.0, 45.0, 60.0, 70.0, 75.0, 80.0, 83.0, 86.0, 88.0, 89.0, 90.0)
_SEEN_FROM_DEG = ((0.0, 0.5, 1.0, 2.0), *((x,) for x in _KNOTS_DEG[1:-1]), (89.0,))
"""Incidences at which the albedo is taken, for each knot."""
_RADII, _TURNS = 96, 48


@torch.no_grad()
def _bounded(made: RuntimeBrdf, angles: tuple[Tensor, ...]) -> Tensor:
    """A table's values, lowered where it would reflect more than all light.

    Between the nodes a narrow lobe is not its formula: by the least-squares nodes it is right on
    average, but the directional albedo (luminance) may be above 1 by some tenths of a percent. A
    node is divided by the larger albedo of its two directions, where that is above 1: this keeps
    reciprocity, and what it leaves is at most 1.

    Args:
        angles: of the nodes, `[U, V, W]` each, in radians.
    """
    albedos = [max(_luminous_albedo(made, x) for x in each) for each in _SEEN_FROM_DEG]
    albedos[1] = max(albedos[:2])  # a cell of the table is some 3 degrees wide at the normal
    excess = torch.tensor(albedos, dtype=torch.float64, device="cpu").clamp(min=1)
    if bool((excess == 1).all()):
        return made.values
    incidence, receiving, tilt = (a.cpu().double() for a in angles)
    knots = torch.tensor(_KNOTS_DEG, dtype=torch.float64, device="cpu").deg2rad()
    by = torch.ones_like(incidence)
    for angle in (incidence, receiving):
        across = torch.hypot(angle.sin() * tilt.cos(), tilt.sin())
        polar = torch.atan2(across, (angle.cos() * tilt.cos()).clamp(min=0))
        high = torch.searchsorted(knots, polar.contiguous()).clamp(1, len(knots) - 1)
        part = (polar - knots[high - 1]) / (knots[high] - knots[high - 1])
        by = torch.maximum(by, excess[high - 1].lerp(excess[high], part))
    return made.values / by[..., None].to(made.values)


def _luminous_albedo(made: RuntimeBrdf, incidence_deg: float) -> float:
    """∫ f_r cos θ dω of light from one direction, in luminance.

    Gauss-Legendre around the mirror direction, the closer to it the closer the nodes.
    """
    like = made.values
    node, weight = np.polynomial.legendre.leggauss(_RADII)
    at = torch.from_numpy((node + 1) / 2).to(like)[:, None]
    radius = math.pi * at**3
    share = torch.from_numpy(weight / 2).to(like)[:, None] * 3 * math.pi * at**2 * radius.sin()
    turn = (torch.arange(_TURNS, device=like.device).to(like) + 0.5) * (math.pi / _TURNS)
    x, y, z = radius.sin() * turn.cos(), radius.sin() * turn.sin(), radius.cos().expand(-1, _TURNS)
    a = math.radians(incidence_deg)
    v = torch.stack([math.cos(a) * x - math.sin(a) * z, y, math.sin(a) * x + math.cos(a) * z])[None]
    l = like.new_tensor([math.sin(a), 0, math.cos(a)]).view(1, 3, 1, 1)  # noqa: E741
    n = like.new_tensor([0, 0, 1]).view(1, 3, 1, 1)
    f = read(like, made.layout.warp, n.expand_as(v), l.expand_as(v), v)
    of_rgb = (f * v[:, 2:].clamp(min=0) * share).sum((0, 2, 3)) * (2 * math.pi / _TURNS)
    return float(of_rgb @ like.new_tensor(SRGB_LUMINANCE))
