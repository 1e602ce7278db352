"""G-buffers in a renderer's world: Blender's own file, and analytic ones in every space."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.files.gbuffer_file import read_gbuffer
from raden_torch.brdf.files.gbuffer_reading import GBufferReading
from raden_torch.brdf.files.renderer_presets import PRESETS, preset
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels
from raden_torch.images.exr_header import Part, Window

OpenEXR = pytest.importorskip("OpenEXR")

BLENDER = Path(__file__).parent / "blender/shell_on_lacquer.exr"
"""By Blender 4.5 and examples/blender/write_gbuffer.py: a ball of radius 1 about (0.3, 0.2, 1),
material 1, on the plane z = 0, material 2; the camera stands at (4, −5, 3)."""
CAMERA = BLENDER.with_suffix(".json")

SIZE, FOV = (48, 64), 40.0
TO_Y_UP = {
    "y-up": np.eye(3),
    "z-up": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "unreal": np.array([[0, 1, 0], [0, 0, 1], [-1, 0, 0]]),
}


def ball(gbuffer: GBuffer) -> Tensor:
    """`[1, 1, H, W]`, where Blender's ball is seen and not its outline."""
    assert gbuffer.position is not None
    off = gbuffer.position - torch.tensor([0.3, 1.0, -0.2]).view(3, 1, 1)
    return (torch.linalg.vector_norm(off, dim=1, keepdim=True) < 1.001) & (gbuffer.mask > 0)


class TestBlender:
    def test_world_becomes_y_up(self) -> None:
        g = read_gbuffer(BLENDER, camera=(4, -5, 3), **preset("blender"))
        inside = ball(g)
        assert int(inside.sum()) > 500
        radial = g.position - torch.tensor([0.3, 1.0, -0.2]).view(3, 1, 1)
        error = (g.normal - radial).abs().amax(1, keepdim=True)
        assert float(error[inside].max()) < 2e-3  # a mesh of 128 x 64
        floor = ~inside & (g.mask > 0)
        assert float(g.position[:, 1:2][floor].abs().max()) < 1e-5
        assert g.camera is not None
        assert torch.as_tensor(g.camera).flatten().tolist() == [4, 3, 5]

    def test_the_camera_file_says_the_same(self) -> None:
        asked = preset("blender")
        by_option = read_gbuffer(BLENDER, camera=(4, -5, 3), **asked)
        by_file = read_gbuffer(BLENDER, camera_file=CAMERA, **asked)
        assert torch.equal(by_option.position, by_file.position)
        assert by_file.camera == pytest.approx((4, 3, 5))

    def test_depth_gives_blenders_own_positions(self, tmp_path: Path) -> None:
        part = {k: v for k, v in read_all(BLENDER).items() if "Position" not in k}
        write_channels(tmp_path / "z.exr", part)
        asked = {"camera_file": CAMERA, **preset("blender")}
        known, found = read_gbuffer(BLENDER, **asked), read_gbuffer(tmp_path / "z.exr", **asked)
        off = torch.linalg.vector_norm(found.position - known.position, dim=1)
        assert float((off * (known.mask[:, 0] > 0)).max()) < 1e-4

    def test_depth_alone_is_brought_into_the_world(self, tmp_path: Path) -> None:
        write_channels(tmp_path / "z.exr", {"Z": read_all(BLENDER)["ViewLayer.Depth.Z"]})
        g = read_gbuffer(tmp_path / "z.exr", camera_file=CAMERA, **preset("blender"))
        floor = (g.position[:, 1:2].abs() < 1e-4) & (g.mask > 0)
        assert int(floor.sum()) > 500
        up = g.normal[:, 1:2][floor]
        assert float((up > 0.999).float().mean()) > 0.9  # not beside the ball

    def test_index_pass_and_mask(self) -> None:
        shell = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        palette = Palette([shell, shell, shell])
        g = read_gbuffer(BLENDER, camera=(4, -5, 3), palette=palette, **preset("blender"))
        inside = ball(g)
        assert g.material is not None
        assert set(g.material[inside].tolist()) == {1}
        assert set(g.material[~inside & (g.mask > 0)].tolist()) == {2}
        assert 0.5 < float(g.mask.mean()) < 0.8  # the rest is sky

    def test_another_camera_is_warned_of(self) -> None:
        with pytest.warns(UserWarning, match="face away from the camera"):
            read_gbuffer(BLENDER, camera=(-4, 5, -3), **preset("blender"))

    @pytest.mark.parametrize("asked", [{}, {"fov_deg": 40.0}])
    def test_without_a_camera_it_says_what_to_give(self, asked: dict[str, float]) -> None:
        with pytest.raises(InputError, match=r"camera: expected .*--camera x,y,z"):
            read_gbuffer(BLENDER, **asked, **preset("blender"))


def read_all(path: Path) -> dict[str, np.ndarray]:
    from raden_torch.images.exr import read_channels

    return read_channels(path)


class Scene:
    """A ball at (0.2, 0.1, −0.3) of our world, seen from (1, 2, 5), as maps `[H, W, 3]`."""

    centre, origin = np.array([0.2, 0.1, -0.3]), np.array([1.0, 2.0, 5.0])

    def __init__(self) -> None:
        back = self.origin - self.centre
        right = np.cross([0, 1, 0], back)
        axes = np.stack([right, np.cross(back, right), back], 1)
        self.axes = axes / np.linalg.norm(axes, axis=0)
        h, w = SIZE
        focal = w / 2 / np.tan(np.radians(FOV) / 2)
        y, x = np.mgrid[:h, :w]
        self.rays = np.stack(
            [(x - (w - 1) / 2) / focal, -(y - (h - 1) / 2) / focal, -np.ones(SIZE)], -1
        )
        d = self.rays @ self.axes.T
        a, b = (d * d).sum(-1), (d * back).sum(-1)
        root = b * b - a * (back @ back - 1)
        self.hit = root > 0
        t = np.where(self.hit, (-b - np.sqrt(np.maximum(root, 0))) / a, 0)
        self.depth = t  # along −z, by the rays' length
        self.position = (self.origin + t[..., None] * d) * self.hit[..., None]
        self.normal = (self.position - self.centre) * self.hit[..., None]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene()


def layer(name: str, vectors: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{name}.{c}": vectors[..., k].astype(np.float32) for k, c in enumerate("XYZ")}


def check(found: GBuffer, scene: Scene, atol: float = 2e-6) -> None:
    def of(m: np.ndarray) -> Tensor:
        return torch.from_numpy(m.astype(np.float32)).movedim(-1, 0)[None]

    inside = torch.from_numpy(scene.hit)[None, None]
    torch.testing.assert_close(found.normal * inside, of(scene.normal), atol=atol, rtol=0)
    if found.position is not None:
        torch.testing.assert_close(
            found.position * inside, of(scene.position), atol=4 * atol, rtol=0
        )
    view = found.view_map(found.normal)
    true = of(scene.origin - scene.position)
    cosine = torch.cosine_similarity(view.double(), true.double(), dim=1)
    assert float(cosine[inside[:, 0]].min()) > 1 - 1e-10


def camera_file(path: Path, world: str, scene: Scene, **more: object) -> Path:
    own = {
        k: (v @ TO_Y_UP[world]).tolist()
        for k, v in (("position", scene.origin), ("target", scene.centre))
    }
    path.write_text(json.dumps({**own, **more}))
    return path


@pytest.mark.parametrize("world", TO_Y_UP)
@pytest.mark.parametrize("space", ["world", "camera"])
def test_every_world(tmp_path: Path, scene: Scene, world: str, space: str) -> None:
    stored = scene.normal @ (TO_Y_UP[world] if space == "world" else scene.axes)
    maps = layer("N", stored) | layer("P", scene.position @ TO_Y_UP[world])
    write_channels(tmp_path / "g.exr", maps)
    file = camera_file(tmp_path / "c.json", world, scene)
    found = read_gbuffer(
        tmp_path / "g.exr", space=space, position_space="world", world=world, camera_file=file
    )
    check(found, scene)


@pytest.mark.parametrize("kind", ["planar", "distance"])
def test_depth_by_the_camera_file(tmp_path: Path, scene: Scene, kind: str) -> None:
    length = np.linalg.norm(scene.rays, axis=-1) if kind == "distance" else 1.0
    maps = layer("N", scene.normal @ TO_Y_UP["z-up"])
    write_channels(tmp_path / "g.exr", maps | {"Z": (scene.depth * length).astype(np.float32)})
    file = camera_file(tmp_path / "c.json", "z-up", scene, fov_deg=FOV)
    found = read_gbuffer(
        tmp_path / "g.exr", space="world", world="z-up", camera_file=file, depth=kind
    )
    check(found, scene)


@pytest.mark.parametrize("looks_along", [1, -1])
@pytest.mark.parametrize("world", ["y-up", "z-up"])
def test_the_headers_matrices(tmp_path: Path, scene: Scene, world: str, looks_along: int) -> None:
    """`worldToCamera` of a camera along z (RenderMan) or −z, `worldToNDC` with perspective."""
    to_world = np.eye(4)
    to_world[:3, :3] = (TO_Y_UP[world].T @ scene.axes) * [1, 1, -looks_along]
    to_world[:3, 3] = TO_Y_UP[world].T @ scene.origin
    to_camera = np.linalg.inv(to_world).T  # row vectors
    perspective = np.zeros((4, 4))
    perspective[[0, 1, 2, 3], [0, 1, 2, 2]] = 1, 1, 1, -1
    perspective[2, 3] = looks_along
    header = {
        "type": OpenEXR.scanlineimage,
        "worldToCamera": np.ascontiguousarray(to_camera, np.float32),  # it takes no strides
        "worldToNDC": (to_camera @ perspective).astype(np.float32),
    }
    maps = layer("N", scene.normal @ TO_Y_UP[world]) | {"Z": scene.depth.astype(np.float32)}
    with OpenEXR.File(header, maps) as file:
        file.write(str(tmp_path / "g.exr"))
    found = read_gbuffer(
        tmp_path / "g.exr", space="world", world=world, fov_deg=FOV, depth="planar"
    )
    check(found, scene, atol=1e-5)


def test_tangent_space(tmp_path: Path, scene: Scene) -> None:
    """A bump on the ball, in the frame of its normal and of the meridian."""
    tangent = np.cross([0.0, 1.0, 0.0], scene.normal)
    with np.errstate(invalid="ignore"):
        t = np.nan_to_num(tangent / np.linalg.norm(tangent, axis=-1, keepdims=True))
    x, y, z = 0.3, -0.2, np.sqrt(1 - 0.13)
    bumped = x * t + y * np.cross(scene.normal, t) + z * scene.normal
    stored = np.broadcast_to([x, y, z], bumped.shape) * scene.hit[..., None]
    maps = layer("N", stored) | layer("P", scene.position)
    maps |= layer("Ng", scene.normal) | layer("tangent", 2.5 * t + 0.4 * scene.normal)
    write_channels(tmp_path / "g.exr", maps)
    found = read_gbuffer(
        tmp_path / "g.exr", space="tangent", position_space="world", camera=scene.origin.tolist()
    )
    true = torch.from_numpy(bumped.astype(np.float32)).movedim(-1, 0)[None]
    torch.testing.assert_close(found.normal * (found.mask > 0), true, atol=2e-6, rtol=0)


def test_lamps_go_with_the_world() -> None:
    reading = GBufferReading(**preset("blender"))
    assert reading.light(rt.PointLight((1, 2, 3))).position.tolist() == [1, 3, -2]
    sun = reading.light(rt.DirectionalLight((0, 0, 1), 2.0))
    assert (sun.direction.tolist(), sun.irradiance) == ([0, 1, 0], 2.0)
    lamp = rt.PointLight((1, 2, 3))
    assert GBufferReading().light(lamp) == lamp


def test_the_picture_does_not_depend_on_the_renderers_world(tmp_path: Path, scene: Scene) -> None:
    model = rt.fit(rt.simulate_specimen("yakogai", step_deg=35)).model.requires_grad_(False)
    pictures = []
    for world in TO_Y_UP:
        maps = layer("N", scene.normal @ TO_Y_UP[world])
        write_channels(tmp_path / "g.exr", maps | layer("P", scene.position @ TO_Y_UP[world]))
        camera = (scene.origin @ TO_Y_UP[world]).tolist()
        reading = GBufferReading(space="world", world=world, camera=camera)
        lamp = reading.light(rt.PointLight((np.array([3.0, 4.0, 2.0]) @ TO_Y_UP[world]).tolist()))
        pictures.append(rt.shade(model, read_gbuffer(tmp_path / "g.exr", **vars(reading)), lamp))
    assert float(pictures[0].max()) > 0
    assert torch.equal(pictures[0], pictures[1])
    assert torch.equal(pictures[0], pictures[2])


@pytest.mark.parametrize(
    ("held", "message"),
    [
        ({}, "expected camera_to_world, or position and target"),
        ({"position": [0, 0, 1], "target": [0, 0, 1]}, "target away from the position"),
        ({"position": [0, 3, 0], "target": [0, 0, 0]}, "straight above"),
        ({"camera_to_world": np.diag([1.0, 2, 1, 1]).tolist()}, "expected a rotation"),
        ({"camera_to_world": np.zeros((4, 4)).tolist()}, "expected a rotation"),
        ({"positon": [0, 0, 1]}, "position"),
        (
            {"position": [0, 0, 1], "fov_deg": 40, "intrinsics": np.eye(3).tolist()},
            "fov_deg or intrinsics, got both",
        ),
        ({"position": [0, 0, 1], "fov_deg": 190}, "fov_deg"),
    ],
)
def test_wrong_camera_files(tmp_path: Path, held: dict[str, object], message: str) -> None:
    (tmp_path / "c.json").write_text(json.dumps(held))
    with pytest.raises(InputError, match=message):
        read_gbuffer(BLENDER, space="world", camera_file=tmp_path / "c.json")


def test_a_matrix_of_a_left_handed_world_is_refused() -> None:
    with pytest.raises(InputError, match="left-handed"):
        read_gbuffer(BLENDER, space="world", world="unreal", camera_file=CAMERA)


def test_presets_are_readings_and_others_are_named() -> None:
    for attributes in PRESETS.values():
        GBufferReading(**attributes)
    with pytest.raises(InputError, match="expected arnold, blender"):
        preset("maxwell")
    with pytest.raises(InputError, match="space: expected camera, world, tangent, got 'object'"):
        GBufferReading(space="object")


def test_a_matrix_in_the_header_that_shears_is_refused() -> None:
    window = Window(0, 0, 1, 1)
    sheared = tuple(np.array([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]).flat)
    part = Part("", 0, {}, (), window, window, None, 1, "none", 1.0, None, sheared)
    with pytest.raises(InputError, match=r"g\.exr: worldToCamera: expected a rotation"):
        GBufferReading(space="world").frame("g.exr", part)
