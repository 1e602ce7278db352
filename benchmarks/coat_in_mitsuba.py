"""A coat over a simulated shell against Mitsuba 3, which traces paths in a slab above it.

    python benchmarks/coat_in_mitsuba.py [--samples N]

Mitsuba knows a smooth dielectric rectangle, an absorbing medium below it, and a BSDF that reads the
base's f_r from a table; light is a distant sphere, 20° wide, so what is compared is f_r cos θi
over it, without the face's own mirror image. It needs the extra `simulate`.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch

import raden_torch as rt
from raden_torch.brdf.materials.coat import Coated
from raden_torch.capture.photo.simulation.mitsuba_table import Table, table_bsdf

INDEX, ABSORPTION, THICKNESS = 1.53, (1.0, 3.0, 8.0), 0.05
HALF_WIDTH = math.radians(10)
LIGHTS = ((10, 40), (35, 180), (55, 100), (65, 0))
VIEWS = ((0, 0), (20, 0), (30, 90), (45, 180), (60, 300), (70, 20))
STEP = math.radians(2.5)


def direction(polar: float, azimuth: float) -> np.ndarray:
    t, p = math.radians(polar), math.radians(azimuth)
    return np.array([math.sin(t) * math.cos(p), math.sin(t) * math.sin(p), math.cos(t)])


def table_of(model: rt.RadenBrdf) -> Table:
    """The model's f_r on a grid of 2.5° over all angles."""
    half = round(math.pi / 2 / STEP)
    axes = [torch.arange(low, half + 1) * STEP for low in (0, -half, -half)]
    angles = (x[None, None] for x in torch.meshgrid(*axes, indexing="ij"))
    count = [len(a) for a in axes]
    flat = [a.reshape(1, 1, -1, 1) for a in angles]
    f = model.at_angles(*flat)[0, :, :, 0].T.reshape(*count, 3)
    first = np.array([float(a[0]) for a in axes])
    return Table(first, np.full(3, STEP), f.numpy().astype(np.float32))


def traced(table: Table, samples: int) -> Iterator[tuple[tuple[int, int], tuple[int, int], Any]]:
    """Radiance `[3]` of each light and view, by Mitsuba."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    base = table_bsdf(mi, table)
    medium = {
        "type": "homogeneous",
        "albedo": {"type": "rgb", "value": 0.0},
        "sigma_t": {"type": "rgb", "value": [x / max(ABSORPTION) for x in ABSORPTION]},
        "scale": max(ABSORPTION),
    }
    to_world = mi.ScalarTransform4f
    for light in LIGHTS:
        lamp = {
            "type": "sphere",
            "center": list(4000 * direction(*light)),
            "radius": 4000 * math.sin(HALF_WIDTH),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
        }
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "volpath", "max_depth": 40, "hide_emitters": False},
                "coat": {
                    "type": "rectangle",
                    "to_world": to_world().translate([0, 0, THICKNESS]).scale(50),
                    "bsdf": {"type": "dielectric", "int_ior": INDEX, "ext_ior": 1.0},
                    "interior": medium,
                },
                "base": {"type": "rectangle", "to_world": to_world().scale(50), "bsdf": base,
                         "exterior": medium},
                "lamp": lamp,
            }
        )  # fmt: skip
        for view in VIEWS:
            sensor = mi.load_dict(
                {
                    "type": "distant",
                    "direction": list(-direction(*view)),
                    "target": [0.0, 0.0, THICKNESS],
                    "film": {"type": "hdrfilm", "width": 1, "height": 1,
                             "rfilter": {"type": "box"}},
                    "sampler": {"type": "independent", "sample_count": samples},
                }
            )  # fmt: skip
            yield light, view, np.array(mi.render(scene, sensor=sensor, seed=1)).reshape(3)


def computed(coated: Coated, light: tuple[int, int], view: tuple[int, int]) -> np.ndarray:
    """The same by the coat's formula, without its gloss: the lamp by 400 directions."""
    axis = direction(*light)
    across = np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    ring = (np.arange(20) + 0.5) / 20
    cosine = 1 - (1 - math.cos(HALF_WIDTH)) * ring[:, None]
    turn = 2 * np.pi * ring
    sine = np.sqrt(1 - cosine**2)
    beams = (
        cosine[..., None] * axis
        + (sine * np.cos(turn))[..., None] * across
        + (sine * np.sin(turn))[..., None] * np.cross(axis, across)
    )
    l, v = (  # noqa: E741
        torch.from_numpy(x.reshape(-1, 3).T[None, :, :, None].copy())
        for x in (beams, direction(*view))
    )
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).view(1, 3, 1, 1)
    f = coated.formula(up, l, v) - coated.gloss(up, l, v)
    solid_angle = 2 * math.pi * (1 - math.cos(HALF_WIDTH))
    return (f * l[:, 2:].clamp(min=0)).mean((0, 2, 3)).numpy() * solid_angle


@torch.no_grad()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=2**18)
    samples = parser.parse_args().samples
    model = rt.fit(
        rt.simulate_specimen("yakogai", step_deg=10), interpolation="trilinear"
    ).model.double()
    coated = Coated(model, INDEX, ABSORPTION, THICKNESS, roughness=0.001)
    errors = []
    print("light  view    Mitsuba (R, G, B)          formula                    difference")
    for light, view, truth in traced(table_of(model), samples):
        own = computed(coated, light, view)
        errors.append(own / truth - 1)
        print(
            f"{light[0]:2d},{light[1]:3d} {view[0]:2d},{view[1]:3d}  {np.round(truth, 5)}  "
            f"{np.round(own, 5)}  {np.round(100 * errors[-1], 1)} %"
        )
    error = np.array(errors)
    print(f"{error.shape[0]} pairs: RMS {100 * np.sqrt((error**2).mean()):.2f} %, mean "
          f"{100 * error.mean():+.2f} %, largest {100 * np.abs(error).max():.1f} %")  # fmt: skip


if __name__ == "__main__":
    main()
