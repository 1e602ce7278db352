"""RadenMaterial in the current three.js, in Chromium, against the library's picture of the same
normals and positions."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.display import to_display
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.export.gltf_brdf import GltfMaterial
from raden_torch.export.gltf_file import export_gltf
from raden_torch.export.shading_language import export_shader

ROOT = Path(__file__).resolve().parents[2]
MODULES = ROOT / "runtimes/node_modules"
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
SIDE, CAMERA = 128, (0.5, 0.4, 3.1)
SUN = rt.DirectionalLight((1, 2, 2), (2.5, 2.5, 2.5))
WARM = np.array([1, 0.8, 0.6])

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not (
            shutil.which("node")
            and CHROMIUM
            and (MODULES / "three").is_dir()
            and (MODULES / "playwright-core").is_dir()
        ),
        reason="Node.js, Chromium, three or playwright-core is not installed; make runtimes",
    ),
]


@dataclass(frozen=True)
class Drawn:
    folder: Path
    model: rt.RadenBrdf
    sky: torch.Tensor
    nearest: GltfMaterial

    def picture(self, name: str) -> np.ndarray:
        values = np.fromfile(self.folder / f"drawn.{name}", np.uint8)
        return values.reshape(SIDE, SIDE, 4)[::-1, :, :3].astype(int)

    def map(self, name: str) -> torch.Tensor:
        values = np.fromfile(self.folder / f"drawn.{name}", "<f4").reshape(SIDE, SIDE, 4)[::-1]
        return torch.from_numpy(values.copy()).movedim(-1, 0)[None]

    @property
    def on_sphere(self) -> np.ndarray:
        return (self.map("normal")[0, 3] > 0).numpy()

    def wanted(self, *lights: object) -> np.ndarray:
        normal = self.map("normal")
        gbuffer = rt.GBuffer(
            normal[:, :3] * (normal[:, 3:] > 0),
            position=self.map("position")[:, :3],
            camera=CAMERA,
        )
        with torch.no_grad():
            image = to_display(rt.shade(self.model, gbuffer, list(lights)))
        return (image[0].movedim(0, -1) * 255).round().numpy().astype(int)

    def off(self, name: str, *lights: object) -> int:
        wanted = self.wanted(*lights)
        assert wanted.max() > 100
        return int(abs(self.picture(name) - wanted).max())


def surroundings() -> torch.Tensor:
    """A dim room, `[3, 128, 256]`: a bright ceiling, a window, a lamp and a small red one."""
    y, x = np.mgrid[0.5:128, 0.5:256]
    ceiling = np.exp(-((y - 30) ** 2) / 400)[..., None] * np.array([0.3, 0.4, 0.5])
    sky = 0.15 + ceiling
    for row, column, radius, colour in (
        (40, 150, 6, (30, 26, 20)),
        (60, 60, 10, (4, 6, 9)),
        (90, 200, 4, (12, 3, 2)),
    ):
        sky[(y - row) ** 2 + (x - column) ** 2 < radius**2] = colour
    return torch.from_numpy(sky).float().movedim(-1, 0)


def equirectangular(sky: torch.Tensor) -> np.ndarray:
    """As three has it: the first row down, −z a quarter from the left; RGBA."""
    rows = torch.roll(sky, -sky.shape[2] // 4, dims=2).flip(1).movedim(0, -1)
    return np.concatenate([rows.numpy(), np.ones((*rows.shape[:2], 1))], axis=2).astype("<f4")


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    """All scenes, in one visit of a browser."""
    folder = tmp_path_factory.mktemp("three")
    model = rt.fit(rt.simulate_specimen("yakogai", step_deg=10)).model
    for name in ("shell", "other", "short"):
        export_shader(model, folder / f"{name}.glsl")
    (folder / "other.bin").write_bytes(bytes((folder / "shell.bin").stat().st_size))
    (folder / "short.bin").write_bytes((folder / "shell.bin").read_bytes()[:-8])
    nearest = export_gltf(model, folder / "shell.gltf").material
    sky = surroundings()
    equirectangular(sky).tofile(folder / "sky.bin")
    program = Path(__file__).with_name("three.mjs")
    command = ["node", str(program), str(MODULES), str(CHROMIUM), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stderr[-2000:]
    errors = json.loads((folder / "errors.json").read_text())
    # the files that are asked for and not there
    assert [e for e in errors if "status of 404" not in e] == []
    return Drawn(folder, model, sky, nearest)


def lamp(place: tuple[float, float, float], intensity: np.ndarray) -> rt.PointLight:
    return rt.PointLight(place, tuple(float(x) for x in intensity))


def test_lamps_give_shades_picture(drawn: Drawn) -> None:
    assert 0.3 < drawn.on_sphere.mean() < 0.8
    side = (-1.2, 1.0, 1.8)
    spot = lamp((0.8, 1.2, 2.4), 14 * np.array([0.7, 0.9, 1]))
    assert drawn.off("directional", SUN) <= 1
    assert drawn.off("point", lamp(side, 9 * WARM)) <= 1
    assert drawn.off("on_camera", lamp(CAMERA, 8 * np.ones(3))) <= 1
    assert drawn.off("several", SUN, lamp(side, 4 * WARM)) <= 1
    assert drawn.picture("dark").max() == 0
    # of the spot light, what is within its cone
    position = drawn.map("position")[:, :3]
    ray = torch.nn.functional.normalize(position - torch.tensor(spot.position).view(3, 1, 1), dim=1)
    axis = torch.nn.functional.normalize(-torch.tensor(spot.position), dim=0).view(1, 3, 1, 1)
    off_axis = torch.acos((ray * axis).sum(1).clamp(-1, 1))[0].numpy()
    picture, wanted = drawn.picture("spot"), drawn.wanted(spot)
    assert abs(picture - wanted)[drawn.on_sphere & (off_axis < 0.299)].max() <= 1
    assert picture[drawn.on_sphere & (off_axis > 0.301)].max() == 0


def test_what_three_does_with_a_material_it_does_here(drawn: Drawn) -> None:
    directional = drawn.picture("directional")
    for same in ("instanced", "skinned", "tinted", "swapped"):
        assert abs(drawn.picture(same) - directional).max() <= 1, same
    assert drawn.picture("other").max() == 0  # its table holds zeros
    assert (drawn.picture("fog")[drawn.on_sphere] == 0x80).all()
    lit, shadowed = (
        drawn.picture(name)[SIDE // 2, SIDE // 2] for name in ("unshadowed", "shadowed")
    )
    assert lit.max() > 50
    assert shadowed.max() == 0


def test_light_from_all_around(drawn: Drawn) -> None:
    even = torch.tensor([1, 0.9, 0.8]).view(3, 1, 1).expand(3, 64, 128) * 2 / torch.pi
    assert drawn.off("ambient", EnvironmentLight(even, samples="all")) <= 2
    wanted = drawn.wanted(EnvironmentLight(drawn.sky, samples="all"))
    difference = (drawn.picture("environment64") - wanted)[drawn.on_sphere]
    assert wanted.max() > 100
    assert np.sqrt((difference**2).mean()) < 4.5
    assert abs(difference.mean()) < 2
    assert drawn.picture("hemisphere")[drawn.on_sphere].max() > 50


def test_the_gltf_file_is_shown_as_its_formulas_say(drawn: Drawn) -> None:
    """Rationale: three masks otherwise, and takes the film's Fresnel at N·V: nearly the same."""
    loaded = json.loads((drawn.folder / "gltf.json").read_text())
    nearest = drawn.nearest
    assert loaded["type"] == "MeshPhysicalMaterial"
    assert loaded["iridescenceIOR"] == pytest.approx(nearest.film_ior, abs=1e-4)
    assert loaded["iridescenceThicknessRange"][1] == pytest.approx(nearest.thickness_nm, abs=1e-2)
    assert loaded["color"] == pytest.approx(nearest.base_colour, abs=1e-4)
    n, position = drawn.map("normal")[0, :3], drawn.map("position")[0, :3]
    v = torch.nn.functional.normalize(torch.tensor(CAMERA).view(3, 1, 1) - position, dim=0)
    light = torch.nn.functional.normalize(torch.tensor([1.0, 2.0, 2.0]), dim=0).view(3, 1, 1)
    h = torch.nn.functional.normalize(light + v, dim=0)
    pairs = ((n, light), (n, v), (n, h), (v, h))
    cosines = [(a * b).sum(0).flatten().clamp(1e-4, 1).double().numpy() for a, b in pairs]
    radiance = nearest.f_r(*cosines) * cosines[0][:, None] * 2.5
    shown = to_display(torch.from_numpy(radiance.T).reshape(1, 3, SIDE, SIDE).float())
    wanted = (shown[0].movedim(0, -1) * 255).numpy()
    inside = drawn.on_sphere & (cosines[0].reshape(SIDE, SIDE) > 0.2)
    inside &= cosines[1].reshape(SIDE, SIDE) > 0.2
    off = abs(drawn.picture("gltf") - wanted)[inside]
    assert wanted[inside].max() > 100
    assert off.mean() < 8


def test_bad_input_is_said_in_a_line(drawn: Drawn) -> None:
    said = json.loads((drawn.folder / "said.json").read_text())
    assert "missing.json: expected a file, got HTTP status 404" in said["missing"]
    assert said["short"].startswith("shell: expected ")
    assert said["samples"] == "environmentSamples: expected an even number in 2…256, got 7"
    package = json.loads((ROOT / "examples/three/package.json").read_text())
    assert package["devDependencies"]["three"].split(".")[1] == said["revision"]
    runtimes = json.loads((ROOT / "runtimes/package.json").read_text())
    assert package["devDependencies"]["three"] == runtimes["dependencies"]["three"]


def test_the_demonstration_shows_shell_in_lacquer(drawn: Drawn) -> None:
    import cv2

    shown = cv2.imread(str(drawn.folder / "demo.png"))[:560].astype(int)
    colourful = shown.max(axis=2) - shown.min(axis=2) > 20
    assert 0.01 < colourful.mean() < 0.5
    assert (shown.max(axis=2) < 40).mean() > 0.3
