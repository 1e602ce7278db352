"""Is the plugin's reflection torch's, and do its samples follow its density?"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.variants import LLVM, SCALAR, why_no_llvm
from raden_torch.errors import InputError
from raden_torch.export.forms import RuntimeForm
from raden_torch.export.mitsuba.plugin import register
from raden_torch.export.table_file import read_form
from raden_torch.packages import require

LIMIT = 1e-4
"""The largest difference of f_r cos θi from torch's that is allowed, over the largest."""
INCIDENCES_DEG = (0.0, 30.0, 60.0, 80.0, 88.0)
SIGNIFICANCE = 0.01
"""Of all χ² tests together."""

_PAIRS = 500
_SAMPLES, _CELLS, _PARTS = 200_000, 41, 24


@dataclass(frozen=True)
class PluginCheck:
    """What the plugin is like.

    Attributes:
        pairs: how many pairs of directions were compared with torch.
        largest: the largest difference of f_r cos θi over the largest f_r cos θi.
        p_values: of Mitsuba's χ² test, by the viewer's angle in degrees; empty where it cannot run.
        why_no_test: what keeps it from running.
    """

    pairs: int
    largest: float
    p_values: dict[float, float]
    why_no_test: str | None

    def __str__(self) -> str:
        told = ", ".join(f"{angle:g}°: {p:.2f}" for angle, p in self.p_values.items())
        tested = f"χ² test passed ({told})" if told else f"χ² test left out: {self.why_no_test}"
        return (
            f"Mitsuba 3: same reflection as torch's, {self.pairs} pairs of directions, at most "
            f"{self.largest:.1e} of the peak; {tested}"
        )


def verify_plugin(path: str | os.PathLike[str]) -> PluginCheck:
    """Load an exported .xml file in Mitsuba, compare with torch, and run Mitsuba's own χ² test.

    Args:
        path: with its table beside it.

    Raises:
        InputError: a file is missing or damaged; Mitsuba is not installed or cannot load it; its
            reflection is another, or its samples do not follow their density.
    """
    path = Path(path)
    form = read_form(path.with_suffix(".json"))
    require("checks of Mitsuba's plugins", "simulate")
    largest = _largest_difference(form, load(path, SCALAR))
    if not largest <= LIMIT:
        raise InputError(
            f"{path}: expected Mitsuba within {LIMIT:g} of the peak, got {largest:.2g}"
        )
    reason = why_no_llvm()
    if reason is not None:
        return PluginCheck(_PAIRS, largest, {}, reason)
    bsdf = load(path, LLVM)
    found = {angle: chi_square(bsdf, angle) for angle in INCIDENCES_DEG}
    check = PluginCheck(_PAIRS, largest, found, None)
    if not min(found.values()) >= 1 - (1 - SIGNIFICANCE) ** (1 / len(found)):
        raise InputError(f"{path}: expected samples that follow their density, got {check}")
    return check


def load(path: Path, variant: str) -> Any:
    """The BSDF of an .xml file, in a variant that is set by this.

    Raises:
        InputError: there is no such file, or Mitsuba cannot load it.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected a file of `raden export`, got none")
    import mitsuba as mi

    mi.set_variant(variant)
    register()
    try:
        return mi.load_file(str(path))
    except RuntimeError as error:
        line = str(error).strip().splitlines()[-1].strip()
        raise InputError(f"{path}: Mitsuba cannot load it: {line}") from None


def chi_square(bsdf: Any, incidence_deg: float, seed: int = 0) -> float:
    """The p-value of Mitsuba's χ² test of a BSDF's `sample` against its `pdf`; 0 where it finds
    samples that have no density, or a density above 1.

    Its cells are those of `_AroundMirror`: over cells of equal solid angle its trapezoids miss a
    narrow highlight.

    Args:
        bsdf: in a Dr.Jit variant, which is the current one.
        incidence_deg: the viewer's angle to the normal.
    """
    import drjit as dr
    import mitsuba as mi
    from mitsuba.chi2 import ChiSquareTest

    angle, turn = np.deg2rad(incidence_deg), 0.3
    sine = np.sin(angle)
    wi = [float(x) for x in (sine * np.cos(turn), sine * np.sin(turn), np.cos(angle))]
    domain = _AroundMirror(mi, wi)

    def surface(count: int) -> Any:
        si = dr.zeros(mi.SurfaceInteraction3f, count)
        # opaque: one compiled kernel for all viewers
        si.wi = mi.Vector3f(*(dr.opaque(mi.Float, x) for x in wi))
        return si

    def sample(numbers: Any) -> Any:
        si, rest = surface(dr.width(numbers)), mi.Point2f(numbers[1], numbers[2])
        found, weight = bsdf.sample(mi.BSDFContext(), si, numbers[0], rest)
        return found.wo, dr.select(dr.all(weight == 0), 0, mi.Float(1))

    def density(wo: Any) -> Any:
        own = bsdf.pdf(mi.BSDFContext(), surface(dr.width(wo)), wo)
        return own * domain.solid_angle(wo)

    test: Any = ChiSquareTest(
        domain,
        sample,
        density,
        sample_dim=3,
        sample_count=_SAMPLES,
        res=_CELLS,
        ires=_PARTS,
        seed=seed,
    )
    test.run(quiet=True)
    return 0.0 if test.fail else float(test.p_value)


class _AroundMirror:
    """A domain of Mitsuba's χ² test: all directions by the azimuth x around the viewer's mirror
    direction and by y = √(θ/π), with θ the angle to it."""

    def __init__(self, mi: Any, wi: list[float]) -> None:
        self._mi = mi
        self._frame = mi.Frame3f(mi.Vector3f(-wi[0], -wi[1], wi[2]))

    def bounds(self) -> Any:
        return self._mi.ScalarBoundingBox2f([-math.pi, 0.0], [math.pi, 1.0])

    def aspect(self) -> float:
        return 1.5

    def map_forward(self, p: Any) -> Any:
        import drjit as dr

        sine, cosine = dr.sincos(math.pi * p.y * p.y)
        turn_sine, turn_cosine = dr.sincos(p.x)
        around = self._mi.Vector3f(sine * turn_cosine, sine * turn_sine, cosine)
        return self._frame.to_world(around)

    def map_backward(self, w: Any) -> Any:
        import drjit as dr

        own = self._frame.to_local(w)
        return self._mi.Vector2f(dr.atan2(own.y, own.x), dr.sqrt(self._angle(own) / math.pi))

    def solid_angle(self, w: Any) -> Any:
        """dω for dx dy at a direction."""
        import drjit as dr

        angle = self._angle(self._frame.to_local(w))
        return dr.sin(angle) * 2 * dr.sqrt(math.pi * angle)

    def _angle(self, own: Any) -> Any:
        import drjit as dr

        return dr.atan2(dr.sqrt(own.x * own.x + own.y * own.y), own.z)


def _largest_difference(form: RuntimeForm, bsdf: Any) -> float:
    import mitsuba as mi

    light, view = _pairs()
    maps = (torch.from_numpy(w.T.copy()).float()[None, :, None] for w in (light, view))
    normal = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    with torch.no_grad():
        f = form.of_unit_vectors(normal, *maps)[0, :, 0].T.numpy()
    wanted = f * light[:, 2:]
    si, context, got = mi.SurfaceInteraction3f(), mi.BSDFContext(), []
    for to_light, to_view in zip(light.tolist(), view.tolist(), strict=True):
        si.wi = to_view
        got.append([*bsdf.eval(context, si, mi.Vector3f(to_light))])
    return float(np.abs(np.array(got) - wanted).max() / max(np.abs(wanted).max(), 1e-30))


def _pairs() -> tuple[Floats, Floats]:
    """Even by solid angle; a third near each other's mirror direction, a third near each other."""
    random = np.random.default_rng(6)
    z = random.random((2, _PAIRS))
    turn, sine = 2 * np.pi * random.random((2, _PAIRS)), np.sqrt(1 - z**2)
    light, view = np.stack([sine * np.cos(turn), sine * np.sin(turn), z], -1)
    part = _PAIRS // 3
    light[:part] = view[:part] * (-1, -1, 1) + 0.05 * random.normal(size=(part, 3))
    light[part : 2 * part] = view[part : 2 * part] + 0.05 * random.normal(size=(part, 3))
    light[:, 2] = np.abs(light[:, 2])
    return light / np.linalg.norm(light, axis=1, keepdims=True), view
