"""`RadenBrdf`: Take's eq. (2), f_r = I_d · diffuse + I_s · specular, as a torch module."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor, nn

from raden_torch import geometry
from raden_torch.brdf.model import kernel
from raden_torch.brdf.model.diffuse import diffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.brdf.model.runtime_bake import bake
from raden_torch.brdf.model.runtime_table import RuntimeLayout, address_of_angles, read, read_at
from raden_torch.brdf.model.table_errors import TableErrors
from raden_torch.errors import InputError, check_type


class CosineDiffuse(nn.Module):
    """The parameters of eqs (3)–(6): `scale` S in 1/sr and `exponent` n, `[C]` each."""

    def __init__(self, scale: Tensor, exponent: Tensor) -> None:
        super().__init__()
        self.scale = nn.Parameter(scale)
        self.exponent = nn.Parameter(exponent)

    def forward(self, incidence: Tensor, receiving: Tensor, tilt: Tensor) -> Tensor:
        dtype = incidence.dtype
        scale, exponent = self.scale.to(dtype), self.exponent.to(dtype)
        return diffuse(incidence, receiving, tilt, scale, exponent)


@dataclass(frozen=True)
class Provenance:
    """Where a model comes from.

    Attributes:
        sample, instrument: as the measurement named them.
        simulated: True where the measurement was computed.
        measurement_sha256: the hash of the readings (`BrdfMeasurement.sha256`).
        fit: the fit's report, as plain JSON values.
    """

    sample: str = ""
    instrument: str = ""
    simulated: bool = False
    measurement_sha256: str = ""
    fit: dict[str, Any] = field(default_factory=dict)


DEFAULT_LAYOUT = RuntimeLayout((32, 69, 67), (0.4, 0.4))
"""Of a model that says no other; `fit` chooses one for what it has fitted."""

_baked: WeakKeyDictionary[RadenBrdf, tuple[tuple[Any, ...], Tensor]] = WeakKeyDictionary()


class RadenBrdf(nn.Module):
    """A reflection model: a diffuse formula and a table of what was measured.

    This is the *fit form*, eq. (2), which `fit_form` evaluates and which may be edited. Everything
    else reads the *runtime form*, which is baked from it as needed: one table over the whole
    hemisphere (`runtime_table`). How far the two are apart is in the fit's report.

    The specular part is what the table holds beyond the diffuse part, spec = w (table − diffuse),
    with the table's weight w: 1 in the table, fading to 0 beyond. It is negative where the formula
    lies above the table. So with both gains at 1 the model is the table itself where that reaches
    (to the horizon, unless `fit` was asked for the paper's rule), and the diffuse part beyond;
    other gains may make it negative.

    Differentiable in the vectors, the table (`table.values`) and the diffuse parameters
    (`diffuse.scale`, `diffuse.exponent`). Either part may be None.

    Attributes:
        diffuse_gain, specular_gain: I_d and I_s of eq. (2), finite numbers that may be set.
        layout: the nodes of the runtime table.
        provenance: what the model was fitted to.
        errors: what the errors of that measurement do to the runtime table, where `fit` was asked
            for it; else None.

    Examples:
        >>> import torch
        >>> import raden_torch as rt
        >>> model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        >>> up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
        >>> f = model(up, up, up)
        >>> list(f.shape), bool((f > 0).all())
        ([1, 3, 1, 1], True)
        >>> model(up, up, -up).flatten().tolist()  # the viewer is below the horizon
        [0.0, 0.0, 0.0]
    """

    diffuse_gain: float | Tensor
    specular_gain: float | Tensor

    def __init__(
        self,
        diffuse: CosineDiffuse | None,
        table: ReflectanceTable | None,
        *,
        diffuse_gain: float | Tensor = 1.0,
        specular_gain: float | Tensor = 1.0,
        layout: RuntimeLayout = DEFAULT_LAYOUT,
        provenance: Provenance | None = None,
        errors: TableErrors | None = None,
    ) -> None:
        super().__init__()
        self.layout = layout
        self.diffuse = diffuse
        self.table = table
        self.diffuse_gain = diffuse_gain
        self.specular_gain = specular_gain
        self.provenance = provenance or Provenance()
        self.errors = errors

    def __setattr__(self, name: str, value: Any) -> None:
        if name in ("diffuse_gain", "specular_gain"):
            value = _gain(name, value)
        super().__setattr__(name, value)

    def forward(self, normal: Tensor, light: Tensor, view: Tensor) -> Tensor:
        """f_r of each pixel.

        Args:
            normal, light, view: `[B, 3, H, W]` directions away from the surface, of any length,
                broadcastable; float16 and bfloat16 are computed in float32.

        Returns:
            `[B, 3, H, W]` f_r in 1/sr, linear RGB with sRGB primaries, without the cosine. It is
            finite for every input and 0 where the light or the viewer is below the horizon or a
            vector is zero or not finite.

        Raises:
            InputError: see `raden_angles`.
        """
        geometry.check_vector_maps(normal=normal, light=light, view=view)
        self.check_device(normal)
        if kernel.takes(self, normal, light, view):
            return kernel.brdf(self.runtime_table(), self.layout.warp, normal, light, view)
        dtype = self.working_dtype(normal, light, view)
        vectors = (geometry.normalised(m.to(dtype)) for m in (normal, light, view))
        return self.of_unit_vectors(*vectors)

    def of_unit_vectors(
        self,
        n: Tensor,
        l: Tensor,  # noqa: E741
        v: Tensor,
        table: Tensor | None = None,
    ) -> Tensor:
        """`forward` of vectors that are unit, or zero where invalid, and of one dtype.

        Args:
            table: what `runtime_table` gave, where many calls share one.
        """
        table = self.runtime_table() if table is None else table
        if kernel.takes(self, n, l, v):
            return kernel.brdf(table, self.layout.warp, n, l, v)
        return read(table.to(n.dtype), self.layout.warp, n, l, v)

    def runtime_table(self) -> Tensor:
        """`[U, V, W, 3]` f_r in 1/sr: the runtime form that `forward` reads, by `layout`.

        It is made anew where the table, the diffuse parameters or the gains have changed since.
        Change them in place under `torch.no_grad()`; a change through `.data` is not seen.
        """
        in_graph = torch.compiler.is_compiling() or kernel.asks_for_gradient(self)
        if in_graph or kernel.is_transformed(*_sources(self)):
            return bake(self, self.layout)
        state = model_state(self)
        known = _baked.get(self)
        if known is None or known[0] != state:
            # kept for calls of other modes
            with torch.inference_mode(False), torch.no_grad():
                known = _baked[self] = (state, bake(self, self.layout))
        return known[1]

    def at_angles(self, incidence: Tensor, receiving: Tensor, tilt: Tensor) -> Tensor:
        """`forward` by angles, `[..., 1, H, W]` in radians each → `[..., 3, H, W]` in 1/sr.

        Nothing is cut at the horizon here: the caller knows the geometry.
        """
        angles = torch.broadcast_tensors(incidence, receiving, tilt)
        values = self.runtime_table().to(angles[0].dtype)
        return read_at(values, *address_of_angles(self.layout.warp, *angles))

    def fit_form(self, incidence: Tensor, receiving: Tensor, tilt: Tensor) -> Tensor:
        """`at_angles` by eq. (2) itself instead of the runtime table: the reference, and slower."""
        angles = torch.broadcast_tensors(incidence, receiving, tilt)
        return equation_2(self.diffuse, self.table, self.diffuse_gain, self.specular_gain, *angles)

    def upper_bound(self) -> Tensor:
        """`[3]`: what |f_r| of each channel cannot exceed in any geometry, in 1/sr."""
        return self.runtime_table().detach().abs().amax((0, 1, 2))

    @property
    def measured_box_deg(self) -> tuple[tuple[float, float], ...]:
        """First and last measured incidence, receiving and tilt; empty without a table. Where what
        was measured is continued, the table reaches further."""
        if self.table is None:
            return ()
        box = self.provenance.fit.get("box_deg")
        ends = box or zip(self.table.first_deg, self.table.last_deg, strict=True)
        return tuple((float(low), float(high)) for low, high in ends)

    def check_device(self, like: Tensor) -> None:
        """Raise InputError, in one line, unless the model is where the maps are."""
        for name, p in self.named_parameters():
            if p.device != like.device:
                raise InputError(
                    f"model and maps: expected one device, got model {name} on {p.device}, maps "
                    f"on {like.device}; use model.to({str(like.device)!r})"
                )

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        """float64 where an input or the model is, else float32."""
        return geometry.working_dtype(*maps, *self.parameters())

    def extra_repr(self) -> str:
        kind = "simulated " if self.provenance.simulated else ""
        return (
            f"{kind}{self.provenance.sample!r}, diffuse_gain={self.diffuse_gain}, "
            f"specular_gain={self.specular_gain}"
        )


def equation_2(
    part: CosineDiffuse | None,
    table: ReflectanceTable | None,
    diffuse_gain: float | Tensor,
    specular_gain: float | Tensor,
    incidence: Tensor,
    receiving: Tensor,
    tilt: Tensor,
) -> Tensor:
    """Eq. (2): I_d d + I_s w (table − d), of angles `[..., 1, H, W]` of one shape, in radians.

    Returns:
        `[..., 3, H, W]` in 1/sr.
    """
    angles = incidence, receiving, tilt
    shape = list(incidence.shape)
    shape[geometry.XYZ_DIM] = 3
    d = incidence.new_zeros(shape) if part is None else part(*angles)
    f = diffuse_gain * d
    # a gain that is a tensor (an input of an exported graph) cannot decide what is computed
    if table is not None and (isinstance(specular_gain, Tensor) or specular_gain != 0):
        total, weight = table(*angles)
        f = f + specular_gain * weight * (total - d)
    return f


def model_state(model: RadenBrdf) -> tuple[Any, ...]:
    """What differs whenever the runtime table has to."""
    return (
        model.layout,
        *(
            (_Held(x), x.data_ptr(), version_of(x), x.device, x.dtype)
            if isinstance(x, Tensor)
            else x
            for x in _sources(model)
        ),
    )


def version_of(tensor: Tensor) -> int | None:
    """A number that changes whenever the tensor's values are written; None where nobody counts."""
    return None if tensor.is_inference() else tensor._version


@dataclass(frozen=True, eq=False)
class _Held:
    """A tensor by identity. It is kept, or another one might get its place in memory."""

    tensor: Tensor

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Held) and self.tensor is other.tensor

    def __hash__(self) -> int:
        return id(self.tensor)


def _sources(model: RadenBrdf) -> tuple[float | Tensor, ...]:
    """What the runtime table is baked from."""
    return (*model.parameters(), model.diffuse_gain, model.specular_gain)


def _gain(name: str, value: float | Tensor) -> float | Tensor:
    """A tensor, as an exported graph has it, or a number that single precision holds."""
    if isinstance(value, Tensor):
        return value
    check_type(name, value, (float, int, np.floating))
    if not abs(value) <= torch.finfo(torch.float32).max:
        raise InputError(f"{name}: expected a finite number, got {value}")
    return float(value)
