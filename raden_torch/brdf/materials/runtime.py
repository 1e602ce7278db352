"""The runtime form of a material: its formula baked into one table, as `RadenBrdf` is read.

A material whose layers lie in the surface knows only the three angles, so the table of
`model/runtime_table.py` holds it, and the fused kernels read it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

import torch
from torch import Tensor, nn

from raden_torch import geometry
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model import kernel
from raden_torch.brdf.model.model import RadenBrdf, model_state
from raden_torch.brdf.model.runtime_bake import balanced
from raden_torch.brdf.model.runtime_table import (
    RuntimeLayout,
    address_of_angles,
    angles_of,
    read,
    read_at,
)
from raden_torch.errors import InputError

Formula = Callable[[Tensor, Tensor, Tensor], Tensor]
"""f_r `[B, 3, H, W]` in 1/sr of n, l, v, unit and above the horizon."""


class RuntimeBrdf(nn.Module):
    """A runtime table without a fit form: what `shade` reads of a baked material.

    To the fused kernels it is a `RadenBrdf` that has no other parts.

    Attributes:
        layout: the nodes of the table.
        values: `[U, V, W, 3]` f_r in 1/sr.
    """

    values: Tensor
    table = None
    diffuse_gain = specular_gain = 1.0

    def __init__(self, values: Tensor, layout: RuntimeLayout) -> None:
        super().__init__()
        self.layout = layout
        self.register_buffer("values", values)

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """`[B, 3, H, W]` f_r in 1/sr of unit (or zero) vectors; 0 below the horizon."""
        if kernel.takes_tensors(n, l, v, self.values):
            return kernel.brdf(self.values, self.layout.warp, n, l, v)
        return read(self.values.to(n.dtype), self.layout.warp, n, l, v)

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
    parts = (getattr(material, name, None) for name in ("base", "ground", "flakes"))
    return [p for part in parts if part is not None for p in parameters_of(part)]


def _recorded(material: Any) -> bool:
    return torch.is_grad_enabled() and any(p.requires_grad for p in parameters_of(material))


def layout_for(roughness: float) -> RuntimeLayout:
    """Nodes for what has a lobe of this GGX α: closer to the highlight, the narrower it is.

    Many along u and v, since Fresnel's reflectance and a lobe are steep at grazing angles.
    """
    closer = min(1.0, max(0.3, roughness / 0.07))
    return RuntimeLayout((40, 73, 51), (0.5 * closer, 0.35 * closer))


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
    # where light and view both graze a lobe is infinite: these ends hold what is half a node before
    u, w = (
        axis.clamp(-end, end)
        for axis, end in ((u, 1 - 0.5 / (len(u) - 1)), (w, 1 - 1 / (len(w) - 1)))
    )
    angles = angles_of(layout.warp, u[:, None, None], v[:, None], w)
    at = (a.to(like.dtype).reshape(1, 1, -1, layout.shape[2]) for a in angles)
    f = formula(*geometry.vectors_from_angles(*at))
    values = f[0].permute(1, 2, 0).reshape(*layout.shape, 3)
    if not bool(torch.isfinite(values.detach()).all()):
        raise InputError("material: expected a finite f_r in every geometry, got one that is not")
    return RuntimeBrdf(balanced(values).contiguous(), layout)
