"""The viewer in a real browser: its picture against `shade`, and what a person does with it."""

from __future__ import annotations

import base64
import json
import math
import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.display import to_display
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.errors import InputError
from raden_torch.export.viewer_file import LARGEST_BYTES, export_viewer

MODULES = Path(__file__).resolve().parents[2] / "runtimes/node_modules"
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
EYE, HALF_HEIGHT = 3.4, 0.36

needs_browser = pytest.mark.skipif(
    not (shutil.which("node") and CHROMIUM and (MODULES / "playwright-core").is_dir()),
    reason="Node.js, Chromium or playwright-core is not installed; make runtimes",
)


@pytest.fixture(scope="module")
def shells() -> dict[str, rt.RadenBrdf]:
    return {name: rt.fit(rt.simulate_specimen(name)).model for name in ("yakogai", "akoya")}


@pytest.fixture(scope="module")
def page(shells, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "shell.html"
    export_viewer(shells["yakogai"], path)
    return path


def visit(page: Path, folder: Path, *steps: Any, width: int = 640, before: str = "") -> Any:
    """What the page shows at first and after each step."""
    what = {"page": str(page), "width": width, "height": 900, "before": before, "steps": steps}
    program = Path(__file__).with_name("view.mjs")
    command = ["node", str(program), str(MODULES), str(CHROMIUM), str(folder), json.dumps(what)]
    subprocess.run(command, check=True, timeout=280)
    found = json.loads((folder / "viewer.json").read_text())
    assert found["errors"] == []
    assert [url for url in found["requests"] if not url.startswith(("file:", "data:"))] == []
    return found["seen"]


def pixels(url: str) -> np.ndarray:
    coded = np.frombuffer(base64.b64decode(url.split(",", 1)[1]), np.uint8)
    return cv2.imdecode(coded, cv2.IMREAD_UNCHANGED)[..., 2::-1].astype(int)


def sphere_by_shade(model: rt.RadenBrdf, side: int) -> tuple[np.ndarray, np.ndarray]:
    """The viewer's first picture by the library, and where the sphere is, away from its rim."""
    at = (torch.arange(side, dtype=torch.float64) + 0.5) / side * 2 - 1
    y, x = torch.meshgrid(-at * HALF_HEIGHT, at * HALF_HEIGHT, indexing="ij")
    ray = torch.nn.functional.normalize(torch.stack([x, y, -torch.ones_like(x)])[None], dim=1)
    along = -ray[:, 2:] * EYE
    inside = along**2 - (EYE**2 - 1)
    position = torch.tensor([0.0, 0.0, EYE]).view(1, 3, 1, 1) + ray * (
        along - inside.clamp(min=0).sqrt()
    )
    normal = torch.where(inside > 0, position, 0.0).float()
    lamp = math.sin(0.45) * math.cos(0.35), math.sin(0.35), math.cos(0.45) * math.cos(0.35)
    gbuffer = rt.GBuffer(normal, position=position.float(), camera=(0.0, 0.0, EYE))
    with torch.no_grad():
        image = to_display(rt.shade(model, gbuffer, rt.DirectionalLight(lamp)))
    picture = (image[0].movedim(0, -1) * 255).round().numpy().astype(int)
    facing = -(normal * ray.float()).sum(1)[0].numpy()
    return picture, facing > 0.2


@needs_browser
@pytest.mark.slow
def test_the_picture_is_shades_and_a_person_can_move_it(page, shells, tmp_path):
    obj = tmp_path / "corner.obj"
    obj.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n")
    bad = tmp_path / "notes.txt"
    bad.write_text("no mesh")
    first, turned, lit, keyed, plate, part, mesh, refused = visit(
        page,
        tmp_path,
        ("drag", 60, 20),
        ("key", "Shift+ArrowLeft"),
        ("key", "+"),
        ("check", "shape", "plate"),
        ("check", "part", "1"),
        ("file", str(obj)),
        ("file", str(bad)),
    )
    assert first["label"] == "Simulated: yakogai is computed, not measured."
    picture = pixels(first["picture"])
    wanted, inside = sphere_by_shade(shells["yakogai"], first["width"])
    assert picture.shape == wanted.shape
    assert wanted[inside].max() == 255
    difference = abs(picture - wanted).max(axis=-1)[inside]
    assert np.percentile(difference, 99.9) <= 1
    assert difference.max() <= 4  # the mesh's facets, where the highlight is steepest
    angles = [float(word.rstrip("°")) for word in first["angles"][:3]]
    light = np.array([math.sin(0.45) * math.cos(0.35), math.sin(0.35)])
    assert angles[0] + angles[1] == pytest.approx(
        math.degrees(math.asin(np.linalg.norm(light))), abs=1
    )
    # a sphere looks the same when it is turned, but for its facets
    assert abs(pixels(turned["picture"]) - picture)[inside].max() <= 4
    for before, after in ((turned, lit), (lit, keyed), (keyed, plate), (plate, part), (part, mesh)):
        assert abs(pixels(after["picture"]) - pixels(before["picture"])).max() > 8
    assert keyed["stops"] == "+0.2"
    assert mesh["state"] == "corner.obj: 4 triangles"
    assert refused["state"] == "notes.txt: expected a mesh as .obj, .glb or .gltf"


@needs_browser
@pytest.mark.slow
def test_two_shells_at_a_phones_width_and_a_lost_device(shells, tmp_path):
    page = tmp_path / "two.html"
    assert export_viewer(shells["yakogai"], page, compare=shells["akoya"]) < LARGEST_BYTES
    lose = "window.lost = picture.getContext('webgl2').getExtension('WEBGL_lose_context')"
    first, lost, back = visit(
        page,
        tmp_path,
        ("run", f"{lose}; window.lost.loseContext()"),
        ("run", "window.lost.restoreContext()"),
        width=390,
    )
    assert first["wide"] <= 390
    picture, side = pixels(first["picture"]), first["width"]
    for name, half in (("yakogai", slice(0, side // 2)), ("akoya", slice(side // 2 + 1, None))):
        wanted, inside = sphere_by_shade(shells[name], side)
        difference = abs(picture - wanted).max(axis=-1)[:, half][inside[:, half]]
        assert np.percentile(difference, 99) <= 1
    assert lost["state"].startswith("The graphics device was lost")
    assert back["state"] == ""
    assert abs(pixels(back["picture"]) - picture).max() == 0


@needs_browser
@pytest.mark.slow
def test_a_browser_without_webgl_2_is_told(page, tmp_path):
    none = "HTMLCanvasElement.prototype.getContext = () => null;"
    (first,) = visit(page, tmp_path, before=none)
    assert first["state"].startswith("This browser has no WebGL 2")


def test_a_name_cannot_leave_its_element(shells, tmp_path):
    odd = rt.RadenBrdf(shells["akoya"].diffuse, shells["akoya"].table)
    odd.provenance = type(odd.provenance)(sample="</script><script>alert(1)</script>")
    export_viewer(odd, tmp_path / "odd.html")
    text = (tmp_path / "odd.html").read_text()
    assert "</script><script>alert" not in text
    assert text.count("<script") == 3


def test_what_does_not_fit_is_refused(shells, tmp_path):
    with pytest.raises(InputError, match=r"ends in \.html"):
        export_viewer(shells["akoya"], tmp_path / "page.htm")
    large = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
    large.layout = RuntimeLayout((64, 128, 128), (0.4, 0.4))
    with pytest.raises(InputError, match=r"expected a page of at most 3000000 bytes"):
        export_viewer(large, tmp_path / "page.html")
    assert not list(tmp_path.iterdir())
