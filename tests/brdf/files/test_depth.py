"""What a depth channel holds: planar z, or the distance along the ray; and who says which."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import torch
from scipy import ndimage

import raden_torch as rt
from raden_torch.brdf.files.depth_check import shape_by_distance
from raden_torch.brdf.files.gbuffer_file import read_gbuffer
from raden_torch.brdf.files.pinhole import pinhole_matrix, rays
from raden_torch.brdf.shading.depth import RENDERERS
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels

H, W = 96, 128


def through(fov_deg: float) -> np.ndarray:
    """`[3, H, W]`, with −1 along z."""
    return rays(pinhole_matrix(None, fov_deg, (H, W)), 0, H, W)[0].double().numpy()


def plane(r: np.ndarray, normal: tuple[float, float, float]) -> np.ndarray:
    """Planar z `[H, W]` of a plane through (0, 0, −4)."""
    n = np.array(normal)[:, None, None]
    return -4 * normal[2] / (n * r).sum(axis=0)


def sphere(r: np.ndarray, radius: float = 1.2) -> np.ndarray:
    """Of a sphere around (0.3, 0.1, −4), 1e10 beside it."""
    c = np.array([0.3, 0.1, -4.0])[:, None, None]
    a, b = (r * r).sum(axis=0), (r * c).sum(axis=0)
    inside = b * b - a * ((c * c).sum() - radius**2)
    return np.where(inside > 0, (b - np.sqrt(inside.clip(0))) / a, 1e10)


def length(r: np.ndarray) -> np.ndarray:
    return np.linalg.norm(r, axis=0)


def degrees(normal: torch.Tensor, true: torch.Tensor) -> torch.Tensor:
    """Angles between `[3, N]`; by the chord, which is exact for small ones."""
    return torch.rad2deg(2 * torch.asin((normal - true).norm(dim=0).clamp(max=2) / 2))


def test_distance_is_read_as_well_as_planar_depth(shared):
    """Rationale: both files are one sphere. Expected: normals and positions as good from either."""
    folder = shared / "data" / "cases"
    true = torch.from_numpy(np.load(folder / "depth_true_normals.npy")).float().movedim(-1, 0)
    planar = read_gbuffer(folder / "depth_planar.exr", fov_deg=50)
    error = {}
    for kind in ("planar", "distance", "mitsuba"):
        gbuffer = read_gbuffer(folder / "depth_along_ray.exr", fov_deg=50, depth=kind)
        there = (gbuffer.mask[0, 0] > 0) & (true != 0).any(dim=0)
        error[kind] = degrees(gbuffer.normal[0][:, there], true[:, there])
        if kind != "planar":
            off = (gbuffer.position - planar.position)[0][:, there]
            assert float(off.abs().max()) < 2e-6
            radius = (gbuffer.position[0][:, there] - torch.tensor([[0.0], [0], [-4]])).norm(dim=0)
            assert float((radius - 1.2).abs().max()) < 1e-5
    best = degrees(planar.normal[0][:, there], true[:, there])
    assert float(error["distance"].mean()) == pytest.approx(float(best.mean()), abs=1e-4)
    assert torch.equal(error["distance"], error["mitsuba"])
    assert float(error["distance"].median()) < 0.07
    assert float(error["planar"].median()) > 5  # what it was, silently


@pytest.mark.parametrize("kind", ["planar", "distance", "negative", *RENDERERS])
def test_every_kind_from_a_tensor(kind):
    r = through(60)
    z = plane(r, (0.4, -0.2, 1.0))
    stored = {"distance": z * length(r), "negative": -z}.get(RENDERERS.get(kind, kind), z)
    depth = torch.from_numpy(stored)[None, None]
    gbuffer = rt.GBuffer.from_depth(depth, pinhole_matrix(None, 60, (H, W)), kind=kind)
    # from_depth has y down and z forward
    x, y, ahead = gbuffer.position[0].numpy()
    np.testing.assert_allclose(ahead, z, rtol=1e-6)
    np.testing.assert_allclose(y, -r[1] * z, atol=1e-6)
    np.testing.assert_allclose(x, r[0] * z, atol=1e-6)
    n = torch.tensor([0.4, 0.2, -1.0], dtype=torch.float64)
    inner = gbuffer.normal[0, :, 2:-2, 2:-2].reshape(3, -1)
    assert float(degrees(inner, (n / n.norm())[:, None]).max()) < 0.05
    assert bool((gbuffer.mask == 1).all())


def test_positions_beside_normals_are_of_the_depth_kind(tmp_path):
    r = through(60)
    z = plane(r, (0.4, -0.2, 1.0))
    normal = np.broadcast_to(np.array([0.4, -0.2, 1.0])[:, None, None] / 1.0954451, (3, H, W))
    channels = {f"N.{c}": n for c, n in zip("XYZ", normal, strict=True)}
    for kind, stored in (("distance", z * length(r)), ("negative", -z)):
        write_channels(tmp_path / "n.exr", {**channels, "Z": stored})
        gbuffer = read_gbuffer(tmp_path / "n.exr", fov_deg=60, depth=kind)
        np.testing.assert_allclose(gbuffer.position[0].numpy(), r * z, atol=2e-6)
        assert bool((gbuffer.mask == 1).all())


def test_what_is_wrong_with_a_depth_is_said(tmp_path):
    path = tmp_path / "z.exr"
    r = through(40)
    write_channels(path, {"Z": -plane(r, (0.0, 0.0, 1.0))})
    with pytest.raises(
        InputError,
        match=r"z\.exr: depth: expected a valid pixel, got none above 0.*`depth=\"negative\"`",
    ):
        read_gbuffer(path, fov_deg=40)
    assert bool((read_gbuffer(path, fov_deg=40, depth="negative").mask == 1).all())
    with pytest.raises(
        InputError,
        match=r"depth kind: expected planar or distance or negative or blender .*, got 'ray'",
    ):
        read_gbuffer(path, fov_deg=40, depth="ray")


SURFACES = {
    "facing plane": lambda r: plane(r, (0.0, 0.0, 1.0)),
    "tilted plane": lambda r: plane(r, (0.5, -0.3, 1.0)),
    "sphere": sphere,
    "corner": lambda r: np.minimum(plane(r, (0.8, 0.2, 1.0)), plane(r, (-0.6, 0.3, 1.0))),
    "sphere before a wall": lambda r: np.minimum(sphere(r), 1.3 * plane(r, (0.1, 0.0, 1.0))),
}


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("fov_deg", [12, 60])
def test_planes_and_spheres_say_that_they_are_distances(tmp_path, name, fov_deg):
    r = through(fov_deg)
    z = SURFACES[name](r)
    path = tmp_path / "z.exr"
    write_channels(path, {"Z": np.where(z < 1e9, z * length(r), 1e10)})
    with pytest.warns(
        UserWarning, match='surface is a (plane|sphere).*`depth="distance"`'
    ) as found:
        read_gbuffer(path, fov_deg=fov_deg)
    assert len(found) == 1
    assert "z.exr" in str(found[0].message)
    for declared in ("planar", "distance"):  # nothing is said (warnings are errors)
        read_gbuffer(path, fov_deg=fov_deg, depth=declared)
    write_channels(path, {"Z": z})
    read_gbuffer(path, fov_deg=fov_deg)


def test_other_surfaces_say_nothing():
    """Rationale: the hint assumes planes or spheres. Expected: none of 60 others is taken for one,
    smooth at any scale, in single or half precision, or a plane with noise."""
    rng = np.random.default_rng(5)
    for k in range(60):
        fov = rng.uniform(8, 100)
        r = through(fov)
        height = ndimage.gaussian_filter(rng.normal(size=(H, W)), rng.uniform(2, 40), mode="wrap")
        height *= np.exp(rng.uniform(np.log(1e-4), np.log(0.2))) / height.std()
        tilt = (rng.normal() / 2, rng.normal() / 2, 1.0)
        base = plane(r, tilt) if k % 3 == 0 else sphere(r, 2.0) if k % 3 == 1 else 4.0
        z = torch.from_numpy(base * (1 + height)).float()[None, None]
        z = z.half().float() if k % 2 else z
        there = (z > 0) & (z < 1e9) & torch.isfinite(z)
        assert shape_by_distance(z, there, torch.from_numpy(r)[None].float()) is None


def test_real_depth_says_nothing(shared):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        read_gbuffer(shared / "data" / "gbuffer" / "singlepart.0001.exr", fov_deg=54)
    assert not [w for w in found if "distance" in str(w.message)]


def test_mitsuba_s_depth_is_a_distance():
    """Rationale: the table of renderers against the renderer itself. Expected: distance from the
    near clipping plane along the ray, of a plane seen under 60°."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    facing = mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, -1], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    sampler = {"type": "independent", "sample_count": 1}
    near = 0.5
    scene = {
        "type": "scene",
        "integrator": {"type": "aov", "aovs": "d:depth,p:position"},
        "sensor": {"type": "perspective", "fov": 60, "near_clip": near, "film": film}
        | {"sampler": sampler, "to_world": facing},
        "wall": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0, -4]).scale(20),
        },
    }
    pixels = np.array(mi.render(mi.load_dict(scene)))
    depth, position = pixels[..., -4], pixels[..., -3:]
    distance = np.linalg.norm(position, axis=-1)
    np.testing.assert_allclose(depth, distance * (1 - near / 4), rtol=1e-5)
