"""Lines and planes cut out of a grid, of scattered readings, or of a model.

Angles go by their names here: `ANGLES`. Values are linear RGB reflectance factors, the perfect
reflecting diffuser = 100.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import torch

from raden_torch.arrays import Floats
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.model.runtime_table import address_of_angles, read_at
from raden_torch.measurement import BrdfMeasurement, ReadingGrid
from raden_torch.measurement.readings import FACTOR_PER_SR

ANGLES = ("incidence", "receiving", "tilt")
ANGLE_LIMITS_DEG = {"incidence": (0.0, 90.0), "receiving": (-90.0, 90.0), "tilt": (-90.0, 90.0)}

SLAB_DEG = 2.5
"""A scattered reading this far from the held angle is still in the cut."""
OUTSIDE_DEG = 10.0
"""How far beyond its box a model's lines are drawn."""
FINE_DEG, COARSE_DEG = 1.0, 2.5
"""Steps at which a model's lines and planes are drawn."""
_SAME_DEG = 0.5  # grid nodes this close count as receiving = incidence
_MANY = {"incidence": "incidences", "receiving": "receiving angles", "tilt": "tilts"}


class NotMeasuredError(Exception):
    """A cut cannot be made; the message says what it needs."""


@dataclass(frozen=True)
class Cut:
    """Values along the free angles, with the others held.

    Attributes:
        deg: the angle of every value, `[K]`, `[K, L]` or, where scattered, `[M]` each; in degrees.
        values: `[..., 3]`; NaN where not measured.
        held: the held angles in words, as really found.
        joined: neighbours in the arrays are neighbours in angle.
        std: `[..., 3]`, by all errors but the scale's; None where none are stated.
    """

    deg: dict[str, Floats]
    values: Floats
    held: str
    joined: bool = True
    std: Floats | None = None

    def along(self, tilt: Any) -> Cut:
        """Of a cut over incidence × tilt, one tilt; of scattered readings, some of them."""
        at = (..., tilt) if self.joined else tilt
        deg = {name: angle[at] for name, angle in self.deg.items()}
        pick = (slice(None), tilt) if self.joined else tilt
        std = None if self.std is None else self.std[pick]
        return replace(self, deg=deg, values=self.values[pick], std=std)


class Samples(Protocol):
    """What can be cut."""

    def cut(self, free: Sequence[str], held: Mapping[str, float]) -> Cut:
        """Values along the `free` angles near the `held` ones (degrees).

        Raises:
            NotMeasuredError: there are none, or they lie on too few angles.
        """

    def mirror(self) -> Cut:
        """All values with receiving = incidence: over incidence × tilt, or scattered.

        Raises:
            NotMeasuredError: there are none.
        """

    def limits(self, angle: str) -> tuple[float, float]:
        """The least and greatest measured angle in degrees."""


@dataclass(frozen=True)
class GridSamples:
    """A measurement on a grid; a held angle is taken at the nearest node with valid readings."""

    grid: ReadingGrid
    std: Floats | None = None
    """`[A, R, T, 3]`, as `grid.values`."""

    def cut(self, free: Sequence[str], held: Mapping[str, float]) -> Cut:
        axes = dict(zip(ANGLES, self.grid.axes_deg, strict=True))
        _check_many({name: axes[name] for name in free})
        distance = np.zeros(())
        for i, name in enumerate(ANGLES):
            away = abs(axes[name] - held[name]) if name in held else np.zeros(1)
            distance = distance + away.reshape([-1 if j == i else 1 for j in range(3)])
        across = tuple(ANGLES.index(name) for name in free)
        enough = self.grid.measured.sum(axis=across, keepdims=True) >= 2
        if not enough.any():
            raise NotMeasuredError("needs two valid readings side by side")
        node = np.unravel_index(np.argmin(np.where(enough, distance, np.inf)), distance.shape)
        pick = tuple(slice(None) if ANGLES[i] in free else node[i] for i in range(3))
        mesh = np.meshgrid(*self.grid.axes_deg, indexing="ij")
        real = {name: float(axes[name][node[ANGLES.index(name)]]) for name in held}
        deg = {name: mesh[i][pick] for i, name in enumerate(ANGLES)}
        std = None if self.std is None else self.std[pick]
        return Cut(deg, self.grid.values[pick], in_words(real), std=std)

    def mirror(self) -> Cut:
        incidence, receiving, tilt = self.grid.axes_deg
        i, j = np.nonzero(abs(incidence[:, None] - receiving) <= _SAME_DEG)
        a, t = np.meshgrid(incidence[i], tilt, indexing="ij")
        r = np.broadcast_to(receiving[j, None], a.shape)
        std = None if self.std is None else self.std[i, j]
        return _mirror_cut((a, r, t), self.grid.values[i, j], joined=True, std=std)

    def limits(self, angle: str) -> tuple[float, float]:
        return _range(self.grid.axes_deg[ANGLES.index(angle)])


@dataclass(frozen=True)
class ScatteredSamples:
    """Readings off any grid; a cut is a slab of `SLAB_DEG` around the readings nearest to it."""

    readings: BrdfMeasurement

    def cut(self, free: Sequence[str], held: Mapping[str, float]) -> Cut:
        deg = self._angles()
        use = self.readings.valid.copy()
        for name, wanted in held.items():
            if not use.any():
                raise NotMeasuredError("needs valid readings")
            centre = deg[name][use][np.argmin(abs(deg[name][use] - wanted))]
            near_wanted = abs(centre - wanted) <= SLAB_DEG
            use &= abs(deg[name] - (wanted if near_wanted else centre)) <= SLAB_DEG
        _check_many({name: deg[name][use] for name in free})
        real = {name: float(np.mean(deg[name][use])) for name in held}
        picked = {name: column[use] for name, column in deg.items()}
        std = None if self.readings.std is None else self.readings.std[use]
        values = self.readings.values[use]
        return Cut(picked, values, in_words(real, about=True), joined=False, std=std)

    def mirror(self) -> Cut:
        a, r, t = self._angles().values()
        use = (abs(a - r) <= SLAB_DEG) & self.readings.valid
        std = None if self.readings.std is None else self.readings.std[use]
        values = self.readings.values[use]
        return _mirror_cut((a[use], r[use], t[use]), values, joined=False, std=std)

    def limits(self, angle: str) -> tuple[float, float]:
        return _range(self._angles()[angle])

    def _angles(self) -> dict[str, Floats]:
        return {name: getattr(self.readings, f"{name}_deg") for name in ANGLES}


@dataclass(frozen=True)
class ModelSamples:
    """A model, asked at any angle; lines in 1° steps, planes in 2.5° steps, inside its box."""

    model: RadenBrdf

    def cut(self, free: Sequence[str], held: Mapping[str, float]) -> Cut:
        step = FINE_DEG if len(free) == 1 else COARSE_DEG
        beyond = OUTSIDE_DEG if len(free) == 1 else 0.0
        axes = [
            self._axis(name, step, beyond) if name in free else np.array([held[name]])
            for name in ANGLES
        ]
        mesh = np.meshgrid(*axes, indexing="ij")
        shape = [len(axis) for axis, name in zip(axes, ANGLES, strict=True) if name in free]
        deg = {name: m.reshape(shape) for name, m in zip(ANGLES, mesh, strict=True)}
        values, std = model_factors(self.model, deg), model_std(self.model, deg)
        return Cut(deg, values, in_words(held), std=std)

    def mirror(self) -> Cut:
        a_low, a_high = self.limits("incidence")
        r_low, r_high = self.limits("receiving")
        low, high = max(a_low, r_low), min(a_high, r_high)
        if low > high:
            raise NotMeasuredError("needs readings at receiving = incidence")
        t_low, t_high = self.limits("tilt")
        a, t = np.meshgrid(_steps(low, high), _steps(t_low, t_high), indexing="ij")
        deg = {"incidence": a, "receiving": a, "tilt": t}
        values, std = model_factors(self.model, deg), model_std(self.model, deg)
        return _mirror_cut((a, a, t), values, joined=True, std=std)

    def limits(self, angle: str) -> tuple[float, float]:
        if self.model.table is None:
            low, high = ANGLE_LIMITS_DEG[angle]
            return max(low, -80.0), min(high, 80.0)
        return self.model.measured_box_deg[ANGLES.index(angle)]

    def _axis(self, angle: str, step: float, beyond: float) -> Floats:
        """The box and what lies `beyond` it; in steps of about `step` that meet its edges."""
        low, high = self.limits(angle)
        least, most = ANGLE_LIMITS_DEG[angle]
        inside = _steps(low, high, step)
        outside = np.arange(step, beyond + step / 2, step)
        axis = np.concatenate([low - outside[::-1], inside, high + outside])
        return axis[(axis >= least) & (axis <= most)]


def model_factors(model: RadenBrdf, deg: Mapping[str, Floats]) -> Floats:
    """`[..., 3]` reflectance factors of a model at angles in degrees, computed in float64."""
    with torch.no_grad():
        f_r = model.fit_form(*_angles_of(model, deg))[:, :, 0]
    return f_r.T.cpu().numpy().reshape(*deg["tilt"].shape, 3) * FACTOR_PER_SR


def model_std(model: RadenBrdf, deg: Mapping[str, Floats]) -> Floats | None:
    """`[..., 3]` their standard deviations by all errors but the scale's; None of a model that
    knows none."""
    if model.errors is None:
        return None
    at = address_of_angles(model.layout.warp, *_angles_of(model, deg))
    found = read_at(model.errors.channels.double(), *at)[:, :, 0].T.cpu().numpy()
    std = np.sqrt((found.reshape(len(found), -1, 3) ** 2).sum(1))
    return std.reshape(*deg["tilt"].shape, 3) * FACTOR_PER_SR


def _angles_of(model: RadenBrdf, deg: Mapping[str, Floats]) -> list[torch.Tensor]:
    """Incidence, receiving and tilt, `[1, M, 1]` in radians, where the model is."""
    device = next(iter(model.parameters()), torch.zeros(())).device
    return [
        torch.tensor(np.deg2rad(deg[name]).reshape(1, -1, 1), dtype=torch.float64, device=device)
        for name in ANGLES
    ]


def _mirror_cut(
    angles: tuple[Floats, Floats, Floats], values: Floats, *, joined: bool, std: Floats | None
) -> Cut:
    if np.isnan(values).all():
        raise NotMeasuredError("needs readings at receiving = incidence")
    deg = dict(zip(ANGLES, angles, strict=True))
    return Cut(deg, values, "receiving = incidence", joined, std)


def _check_many(axes: Mapping[str, Floats]) -> None:
    """Raise where an axis has one value only, or none."""
    few = [name for name, axis in axes.items() if len(axis) < 2 or np.ptp(axis) == 0]
    if few:
        raise NotMeasuredError("needs several " + " and ".join(_MANY[name] for name in few))


def in_words(held: Mapping[str, float], *, about: bool = False) -> str:
    """Angles in degrees, as "incidence 20°, tilt −10°"."""
    sign = "≈ " if about else ""
    words = (f"{name} {sign}{round(angle, 1) + 0.0:g}°" for name, angle in held.items())
    return ", ".join(words).replace("-", "−")


def _range(angles: Floats) -> tuple[float, float]:
    return float(angles.min()), float(angles.max())


def _steps(low: float, high: float, step: float = FINE_DEG) -> Floats:
    """From low to high in equal steps of about `step`, both ends included."""
    return np.linspace(low, high, max(round((high - low) / step), 1) + 1)
