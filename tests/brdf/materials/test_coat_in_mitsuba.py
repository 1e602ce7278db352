"""A coat over Lambert's base against Mitsuba's own layered model, `plastic`."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.urushi import Lambertian


@pytest.mark.slow
def test_a_coat_over_lamberts_base_is_mitsubas_plastic() -> None:
    """Rationale: Mitsuba's `plastic` (nonlinear: with colour shifts by inner reflections) is the
    same two layers, smooth, without absorption. Expected: equal to 0.5 %, from the quadrature of
    either."""
    mi = pytest.importorskip("mitsuba", reason="needs the extra simulate")
    try:
        mi.set_variant("scalar_rgb")
    except ImportError as error:
        pytest.skip(f"no variant scalar_rgb: {error}")
    albedo = (0.8, 0.4, 0.1)
    plastic = mi.load_dict(
        {
            "type": "plastic",
            "int_ior": 1.53,
            "ext_ior": 1.0,
            "nonlinear": True,
            "diffuse_reflectance": {"type": "rgb", "value": list(albedo)},
        }
    )
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).view(1, 3, 1, 1)
    coated = Coated(Lambertian(albedo), index=1.53, roughness=0.001)
    body = coated._parts(up, once=True, gloss=False)
    geometries = (0, 10, 0), (30, 60, 90), (50, 20, 200), (75, 5, 30), (80, 70, 60)
    for polar_l, polar_v, turn in geometries:
        a, b, p = (math.radians(x) for x in (polar_l, polar_v, turn))
        light = (math.sin(a), 0.0, math.cos(a))
        view = (math.sin(b) * math.cos(p), math.sin(b) * math.sin(p), math.cos(b))
        si = mi.SurfaceInteraction3f()
        si.wi = mi.Vector3f(*view)
        truth = np.array(plastic.eval(mi.BSDFContext(), si, mi.Vector3f(*light))) / light[2]
        l, v = (torch.tensor(x, dtype=torch.float64).view(1, 3, 1, 1) for x in (light, view))  # noqa: E741
        own = body(up, l, v).flatten().numpy()
        np.testing.assert_allclose(own, truth, rtol=5e-3)
