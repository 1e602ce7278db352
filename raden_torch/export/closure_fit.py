"""A model as a sum of microfacet lobes, as renderers' closures are: the nearest of such sums.

A closure does not know where the light is; its weight, its roughness and its normal may follow the
viewer alone. So the reflection at each of some viewing angles is a sum of one matt closure and of
GGX lobes about leaning normals, with weights of 0 or more in each channel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import nnls
from threadpoolctl import threadpool_limits

from raden_torch.arrays import Floats
from raden_torch.export.forms import RuntimeForm

VIEWS = 24
"""Viewing angles, evenly from 0 to `LAST_DEG`."""
LAST_DEG = 86.0
LOBES = 12
"""Closures, the matt one among them: renderers take some dozens at one point."""
_LIGHTS = 1600
_RINGS = {
    6.0: (0.06, 0.12),
    12.0: (0.08, 0.15),
    18.0: (0.1, 0.2),
    27.0: (0.15, 0.3),
    40.0: (0.2, 0.4),
}
"""How far a lobe's normal leans, in degrees, and its α."""
_UPRIGHT = (0.04, 0.08, 0.15, 0.3, 0.6)


@dataclass(frozen=True)
class Lobe:
    """A closure.

    Attributes:
        alpha: of GGX; 0 is the matt one.
        lean_deg: of its normal to the surface's.
        azimuth_deg: of that, about the normal, from the viewer's, counter-clockwise from above.
    """

    alpha: float
    lean_deg: float = 0.0
    azimuth_deg: float = 0.0

    @property
    def normal(self) -> tuple[float, float, float]:
        """Its normal: x towards the viewer along the surface, z the surface's normal."""
        lean, azimuth = np.deg2rad(self.lean_deg), np.deg2rad(self.azimuth_deg)
        x, y = (float(np.sin(lean) * f(azimuth)) for f in (np.cos, np.sin))
        return x, y, float(np.cos(lean))

    def radiance(self, light: Floats, view: Floats) -> Floats:
        """What weight 1 makes of unit irradiance facing the light, `[N]`: f_r cos θi, both about
        the lobe's own normal; cos θi / π of the matt one.

        Walter et al., Microfacet models for refraction through rough surfaces (EGSR 2007), eqs (20)
        and (33), without Fresnel's term; masking as in `microfacet.visible`.
        """
        n = np.array(self.normal)
        cos_i, cos_r = light @ n, view @ n
        if self.alpha == 0:
            return np.maximum(cos_i, 0) / np.pi
        half = light + view
        half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-12)
        square = self.alpha**2
        facets = square / (np.pi * ((half @ n) ** 2 * (square - 1) + 1) ** 2)
        i, r = np.maximum(cos_i, 0), np.maximum(cos_r, 0)
        from_i = r * np.sqrt(square + (1 - square) * i**2)
        from_r = i * np.sqrt(square + (1 - square) * r**2)
        value = facets * 0.5 * i / np.maximum(from_i + from_r, 1e-12)
        return np.where((cos_i > 0) & (cos_r > 0), value, 0.0)


@dataclass(frozen=True)
class ClosureFit:
    """The nearest sum.

    Attributes:
        lobes: the closures.
        weights: `[VIEWS, lobes, 3]`, linear RGB, 0 or more; linear in the angle between.
        error: RMS of the difference of f_r cos θi over the RMS of the model's, over all light for
            viewers at angles between those that were fitted.
    """

    lobes: tuple[Lobe, ...]
    weights: Floats
    error: float

    def radiance(self, light: Floats, view_deg: float) -> Floats:
        """f_r cos θi `[N, 3]` for a viewer in the plane of x and z."""
        view = _view(view_deg)
        place = min(view_deg / LAST_DEG, 1.0) * (VIEWS - 1)
        first = min(int(place), VIEWS - 2)
        share = place - first
        weights = (1 - share) * self.weights[first] + share * self.weights[first + 1]
        return np.stack([lobe.radiance(light, view) for lobe in self.lobes], 1) @ weights


def fit_closures(form: RuntimeForm) -> ClosureFit:
    """The sum whose f_r cos θi is nearest in the least-squares sense; its lobes are chosen one by
    one, for all views and channels together."""
    light = _even(_LIGHTS)
    known = [Lobe(0.0), *(Lobe(alpha) for alpha in _UPRIGHT)]
    known += [
        Lobe(alpha, lean, 45.0 * k)
        for lean, alphas in _RINGS.items()
        for alpha in alphas
        for k in range(8)
    ]
    views = np.linspace(0.0, LAST_DEG, VIEWS)
    bases = np.stack(
        [np.stack([lobe.radiance(light, _view(v)) for lobe in known], 1) for v in views]
    )
    wanted = np.stack([_wanted(form, light, v) for v in views])
    with threadpool_limits(1):  # the matrices are small
        chosen = _chosen(bases, wanted)
        weights = _weights(bases[:, :, chosen], wanted)
    fit = ClosureFit(tuple(known[k] for k in chosen), weights, 0.0)
    between = (views[1:] + views[:-1]) / 2
    off = whole = 0.0
    for v in between:
        true = _wanted(form, light, v)
        off += float(((fit.radiance(light, v) - true) ** 2).sum())
        whole += float((true**2).sum())
    return ClosureFit(fit.lobes, weights, float(np.sqrt(off / whole)) if whole else 0.0)


def _chosen(bases: Floats, wanted: Floats) -> list[int]:
    """The places of `LOBES` lobes of `[V, N, K]`, each the one that the rest resembles most."""
    sizes = np.maximum(np.sqrt((bases**2).sum(1)), 1e-9)[:, :, None]
    chosen = [0]
    while len(chosen) < LOBES:
        rest = wanted - bases[:, :, chosen] @ _weights(bases[:, :, chosen], wanted)
        like = np.maximum(np.einsum("vnk,vnc->vkc", bases, rest) / sizes, 0)
        gain = (like**2).sum((0, 2))
        gain[chosen] = -1.0
        chosen.append(int(gain.argmax()))
    return chosen


def _weights(bases: Floats, wanted: Floats) -> Floats:
    """`[V, K, 3]` of 0 or more, of `[V, N, K]` and `[V, N, 3]`."""
    each = [[nnls(a, b[:, c])[0] for c in range(3)] for a, b in zip(bases, wanted, strict=True)]
    return np.array(each).transpose(0, 2, 1)


def _wanted(form: RuntimeForm, light: Floats, view_deg: float) -> Floats:
    """The model's f_r cos θi, `[N, 3]`."""
    l = torch.from_numpy(light.T.copy())[None, :, None]  # noqa: E741
    v = torch.from_numpy(_view(view_deg)).view(1, 3, 1, 1).expand_as(l)
    n = l.new_tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand_as(l)
    with torch.no_grad():
        f = form.of_unit_vectors(n, l, v)[0, :, 0].T
    return f.numpy() * light[:, 2:]


def _view(angle_deg: float) -> Floats:
    angle = np.deg2rad(angle_deg)
    return np.array([np.sin(angle), 0.0, np.cos(angle)])


def _even(count: int) -> Floats:
    """`[N, 3]` directions that are spread evenly over the hemisphere, on a spiral."""
    k = np.arange(count) + 0.5
    z = 1 - k / count
    azimuth, sine = k * np.pi * (3 - np.sqrt(5)), np.sqrt(1 - z**2)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], 1)
