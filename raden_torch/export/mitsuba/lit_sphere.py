"""The sphere of `raden render` in Mitsuba: the same rays, lamp and exposure."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from raden_torch.arrays import Floats

_DISTANCE = 6.0
_MARGIN = 1.08
_LIT = 0.01
LIGHT = (1.0, 1.0, 2.0)


def render_sphere(
    mi: Any,
    bsdf: Any,
    size: int,
    *,
    emitter: Any = None,
    samples: int = 2,
    spp: int | None = None,
    seed: int = 0,
    integrator: Any = None,
) -> Floats:
    """`[size, size, 3]` scene-linear RGB of a unit sphere.

    Args:
        mi: Mitsuba in an RGB variant.
        bsdf: of that variant.
        emitter: a dictionary of Mitsuba's; by default the lamp of `raden render` without options,
            in whose light each ray tells all.
        samples: rays a pixel along each side, through the middles of its parts.
        spp: instead of them, so many random ones.
        seed: of these.
        integrator: a dictionary of Mitsuba's; by default paths of direct light.
    """
    to = mi.ScalarTransform4f
    half_width = _MARGIN / math.sqrt(_DISTANCE**2 - 1)
    even = {"type": "stratified", "sample_count": samples**2, "jitter": False}
    lamp = {
        "type": "directional",
        "direction": [-x for x in LIGHT],
        "irradiance": {"type": "rgb", "value": [math.pi] * 3},
    }
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator or {"type": "path", "max_depth": 2, "hide_emitters": True},
            "sphere": {"type": "sphere", "bsdf": bsdf},
            "lamp": emitter or lamp,
            "sensor": {
                "type": "perspective",
                "fov": math.degrees(2 * math.atan(half_width)),
                "to_world": to().look_at(origin=[0, 0, _DISTANCE], target=[0, 0, 0], up=[0, 1, 0]),
                "sampler": {"type": "independent"} if spp else even,
                "film": {
                    "type": "hdrfilm",
                    "width": size,
                    "height": size,
                    "pixel_format": "rgb",
                    "component_format": "float32",
                    "rfilter": {"type": "box"},
                },
            },
        }
    )
    return np.asarray(mi.render(scene, spp=spp or samples**2, seed=seed), np.float64)


def mean_relative_difference(picture: Floats, wanted: Floats) -> float:
    """Of two pictures `[H, W, 3]`: the mean over the lit pixels of Σ|difference| over Σ|wanted|,
    over the channels. Lit are those above a hundredth of the mean of what is not black: in a pixel
    or two of the terminator next to nothing is divided by next to nothing."""
    total = np.abs(wanted).sum(-1)
    lit = total > _LIT * total[total > 0].mean()
    return float((np.abs(picture - wanted).sum(-1)[lit] / total[lit]).mean())
