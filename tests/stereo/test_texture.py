"""`raden capture texture` on simulated photographs of a flat inlay: two shells of analytic BRDF, in
pieces whose layers lean, in dark lacquer; then relit under a lamp that was held out."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import colour
import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.gbuffer_file import read_gbuffer
from raden_torch.brdf.files.image_file import read_photograph
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.runtime import runtime_brdf
from raden_torch.brdf.materials.urushi import Lambertian
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from tests.stereo.scenes import Shell, lamps_around, shell, unit, write_lights, write_photographs

Array = np.ndarray
SIDE, DARK = 48, 0.01
TURNS = (0.0, 2.0)
PIECES = [(12, 12, 0, (0.10, 0.05)), (12, 36, 1, (-0.12, 0.02)), (36, 12, 1, (0.03, -0.09)),
          (36, 36, 0, (-0.05, -0.11))]  # fmt: skip


@dataclass(frozen=True)
class InlaySet:
    """Photographs in a folder, `held_out` as its true radiance, the true maps."""

    folder: Path
    lamps: Array
    lamp_out: Array
    held_out: Array
    material: Array
    layers: Array

    def command(self, output: Path, *more: object) -> list[object]:
        photos = sorted(self.folder.glob("photo*.png"))
        known = ("--lights", self.folder / "lights.json", "--coded", "linear")
        models = ("--model", self.folder / "one.safetensors", "--model")
        ground = ("--ground", self.folder / "ground.safetensors")
        models = (*models, self.folder / "two.safetensors", *ground)
        return ["capture", "texture", *photos, *known, *models, "-o", output, *more]


def radiance(material: Array, layers: Array, lamp: Array) -> Array:
    """`[H, W, 3]` of irradiance 1: the layers turn the reflection, not the irradiance."""
    made = np.full((*material.shape, 3), DARK / np.pi)
    for place, turn in enumerate(TURNS):
        of = material == place + 1
        made[of] = shell(layers[of], np.broadcast_to(lamp, (of.sum(), 3)), turn)
    return made * lamp[2]


@pytest.fixture(scope="module")
def inlay(tmp_path_factory: pytest.TempPathFactory) -> InlaySet:
    folder = tmp_path_factory.mktemp("inlay")
    y, x = np.mgrid[:SIDE, :SIDE]
    material, layers = np.zeros((SIDE, SIDE), int), np.zeros((SIDE, SIDE, 3))
    layers[..., 2] = 1
    for row, column, which, lean in PIECES:
        of = np.hypot(y - row, x - column) < 9
        material[of], layers[of] = which + 1, unit(np.array([*lean, 1.0]))
    lamps = lamps_around(9)
    out, lamps = lamps[4], np.delete(lamps, 4, 0)
    rng = np.random.default_rng(0)
    linear = np.stack([radiance(material, layers, lamp) for lamp in lamps])
    linear *= 1.4 * (1 + 0.02 * rng.normal(size=(SIDE, SIDE, 1)))
    linear += 0.002 * np.sqrt(linear + 0.01) * rng.normal(size=linear.shape)
    write_photographs(folder, linear)
    write_lights(folder / "lights.json", lamps)
    cv2.imwrite(str(folder / "map.png"), material.astype(np.uint8))
    layout = RuntimeLayout((32, 57, 65), (0.4, 0.3))
    for name, turn in zip(("one", "two"), TURNS, strict=True):
        baked = runtime_brdf(Shell(turn).of_unit_vectors, torch.zeros(1), layout)
        rt.save_model(Palette([baked], [name]), folder / f"{name}.safetensors")
    rt.save_model(Palette([Lambertian((DARK,) * 3)], ["lacquer"]), folder / "ground.safetensors")
    return InlaySet(folder, lamps, out, radiance(material, layers, out), material, layers)


def off_by(found: Array, true: Array) -> Array:
    """ΔE2000, white being the perfect diffuser that faces the lamp."""
    to_xyz = np.linalg.inv(xyz_to_rgb_matrix())
    lab = [colour.XYZ_to_Lab(np.pi * m.clip(0) @ to_xyz.T, [0.3127, 0.329]) for m in (found, true)]
    return np.asarray(colour.delta_E(*lab, method="CIE 2000"))


@pytest.fixture(scope="module")
def found(raden, inlay: InlaySet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("found") / "inlay"
    done = raden(*inlay.command(out, "--gain"))
    assert done.returncode == 0, done.stderr
    assert "2 pieces, layers lean by" in done.stdout
    return out


def test_a_piece_has_its_shell_and_its_layers(inlay: InlaySet, found: Path) -> None:
    assert (cv2.imread(str(found / "material.png"), 0) == inlay.material).mean() > 0.99
    said = json.loads((found / "inlay.json").read_text())
    assert said["materials"] == ["ground", "one", "two"]
    assert len(said["pieces"]) == 4
    true = {tuple(np.round(unit(np.array([*lean, 1.0])), 6)): w + 1 for *_, w, lean in PIECES}
    for piece in said["pieces"]:
        off = {
            np.degrees(np.linalg.norm(np.cross(piece["layer_normal"], normal))): which
            for normal, which in true.items()
        }
        assert min(off) < 0.3
        assert min(off) < 4 * piece["error_deg"]
        assert off[min(off)] == piece["material"]
        assert piece["runner_up"] > 2 * piece["residual"]


def test_info_says_what_was_found(raden, found: Path) -> None:
    done = raden("info", found / "inlay.json")
    assert done.returncode == 0, done.stderr
    assert "4 pieces from 8 photographs, layers: one normal a piece" in done.stdout
    assert "materials: ground, one, two" in done.stdout


def test_relit_under_a_lamp_that_was_held_out(inlay: InlaySet, found: Path) -> None:
    """The G-buffer and the palette, as they are: ΔE2000 of 3 or less in the median."""
    palette = rt.load_model(found / "palette.safetensors")
    gbuffer = read_gbuffer(found / "inlay.exr", palette=palette)
    lamp = rt.DirectionalLight(tuple(inlay.lamp_out), irradiance=(1.0, 1.0, 1.0))
    image = rt.shade(palette, gbuffer, lamp)[0].movedim(0, -1).numpy()
    off = off_by(image, inlay.held_out)
    assert np.median(off[inlay.material > 0]) < 1.0
    assert np.median(off) < 1.0
    # without their layers' normals the pieces would be elsewhere
    flat = rt.GBuffer(gbuffer.normal, view=(0, 0, 1), material=gbuffer.material)
    upright = rt.shade(palette, flat, lamp)[0].movedim(0, -1).numpy()
    assert np.median(off_by(upright, inlay.held_out)[inlay.material > 0]) > 3


def test_the_commands_read_it(raden, inlay: InlaySet, found: Path, tmp_path: Path) -> None:
    """`raden render --gbuffer` and `raden relight --normals inlay.exr` show the same pieces."""
    lamp = ",".join(f"{c:.6f}" for c in inlay.lamp_out)
    model, gbuffer = found / "palette.safetensors", found / "inlay.exr"
    lit = tmp_path / "lit.exr"
    done = raden("render", model, "--gbuffer", gbuffer, f"--light={lamp}", "-o", lit)
    assert done.returncode == 0, done.stderr
    photo = inlay.folder / "photo00.png"
    words = ["relight", photo, "--linear", "--normals", gbuffer, "--model", model]
    words += ["--material", found / "material.png", f"--light={lamp}", "-o", tmp_path / "r.exr"]
    done = raden(*words, "--mask", found / "mask.png")
    assert done.returncode == 0, done.stderr
    rendered, relit = (read_photograph(tmp_path / n).linear for n in ("lit.exr", "r.exr"))
    there = torch.tensor(inlay.material > 0)
    ratio = (relit / rendered)[..., there]
    assert float(ratio.quantile(0.95) / ratio.quantile(0.05)) < 1.02


def test_rows_of_the_layers_are_those_of_the_whole(found: Path) -> None:
    from raden_torch.brdf.files.gbuffer_file import GBufferFile

    file = GBufferFile(found / "inlay.exr")
    whole, part = file.rows(0, SIDE), file.rows(10, 20)
    for name in ("layer_normal", "diffuse_gain"):
        assert torch.equal(getattr(part, name), getattr(whole, name)[:, :, 10:20])
    assert whole.specular_gain is whole.diffuse_gain


def test_a_map_that_is_given_and_layers_by_pixel(raden, inlay: InlaySet, tmp_path: Path) -> None:
    words = inlay.command(tmp_path / "o", "--map", inlay.folder / "map.png", "--per-pixel")
    done = raden(*words)
    assert done.returncode == 0, done.stderr
    assert (cv2.imread(str(tmp_path / "o/material.png"), 0) == inlay.material).all()
    gbuffer = read_gbuffer(tmp_path / "o/inlay.exr")
    layers = gbuffer.layer_normal[0].movedim(0, -1).numpy()[inlay.material > 0]
    off = np.degrees(np.linalg.norm(np.cross(layers, inlay.layers[inlay.material > 0]), axis=1))
    assert np.median(off) < 1.0
    assert gbuffer.diffuse_gain is None


def test_photographs_in_another_order_are_named(raden, inlay: InlaySet, tmp_path: Path) -> None:
    for k, path in enumerate(sorted(inlay.folder.glob("photo*.png"))):
        name = {1: "photo06.png", 6: "photo01.png"}.get(k, path.name)
        shutil.copy(path, tmp_path / name)
    words = inlay.command(tmp_path / "o")
    words[2:10] = sorted(tmp_path.glob("photo*.png"))
    done = raden(*words)
    assert done.returncode == 2
    assert "photo01.png under lamp 7, photo06.png under lamp 2" in done.stderr
    assert not (tmp_path / "o").exists()


def test_clipped_highlights_do_not_matter(raden, inlay: InlaySet, tmp_path: Path) -> None:
    for path in inlay.folder.glob("photo*.png"):
        stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float64)
        bright = np.clip(stored * 2.5, 0, 65535).astype(np.uint16)
        cv2.imwrite(str(tmp_path / path.name), bright)
    words = inlay.command(tmp_path / "o", "--map", inlay.folder / "map.png")
    words[2:10] = sorted(tmp_path.glob("photo*.png"))
    done = raden(*words)
    assert done.returncode == 0, done.stderr
    said = json.loads((tmp_path / "o/inlay.json").read_text())
    normals = [unit(np.array([*lean, 1.0])) for *_, lean in PIECES]
    for piece in said["pieces"]:
        off = [np.degrees(np.linalg.norm(np.cross(piece["layer_normal"], n))) for n in normals]
        assert min(off) < 0.5


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("no model", "--model: expected one for each shell, got none"),
        ("map of another size", "expected the photographs' 48 x 48 pixels, got 24 x 24"),
        ("map with a third", "expected indices 0…2, 0 for the ground and one a shell, got 3"),
        ("mask of another size", "24 x 24"),
        ("a lamp too few", "expected one lamp per photograph"),
        ("no piece", "expected at least one piece of 2000 pixels within the mask, got none"),
    ],
)
def test_bad_input_is_one_line(
    raden, inlay: InlaySet, tmp_path: Path, change: str, said: str
) -> None:
    words = inlay.command(tmp_path / "o")
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.full((24, 24), 1, np.uint8))
    third = tmp_path / "third.png"
    cv2.imwrite(str(third), np.full((SIDE, SIDE), 3, np.uint8))
    if change == "no model":
        words = [*words[:14], "-o", tmp_path / "o"]
    elif change == "a lamp too few":
        words = [*words[:9], *words[10:]]
    more = {
        "map of another size": ("--map", small),
        "map with a third": ("--map", third),
        "mask of another size": ("--mask", small),
        "no piece": ("--map", inlay.folder / "map.png", "--smallest", 2000),
    }
    done = raden(*words, *more.get(change, ()))
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "o").exists()
