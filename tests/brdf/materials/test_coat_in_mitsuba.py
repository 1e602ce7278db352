"""A coat over Lambert's base against Mitsuba's own layered model, `plastic`."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

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


@pytest.mark.slow
def test_a_coat_over_a_measured_table_is_the_slab_that_mitsuba_traces(tmp_path: Path) -> None:
    """Rationale: paths through a real dielectric face above the measured table. Expected: equal to
    four standard errors of the paths, which are below 4 %."""
    pytest.importorskip("mitsuba", reason="needs the extra simulate")
    from raden_torch.capture.photo.simulation.variants import why_no_llvm

    if (reason := why_no_llvm()) is not None:
        pytest.skip(reason)
    script = Path(__file__).parents[3] / "benchmarks" / "coat_in_mitsuba.py"
    size = ("--log2-paths", "18", "--pairs", "2", "--faces", "smooth")
    done = subprocess.run(
        [sys.executable, script, "--out", tmp_path, *size],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    rows = json.loads((tmp_path / "coat_in_mitsuba.json").read_text())
    assert len(rows) == 2
    for row in rows:
        paths, error, own = (np.array(row[k]) for k in ("paths", "error", "formula"))
        assert (paths > 1e-3).all()
        assert (error < 0.04 * paths).all()
        assert (abs(own - paths) < 4 * error).all()
