"""The example applications, a page in Chromium and a script, against the library's picture."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.display import to_display
from raden_torch.brdf.files.image_file import read_normal_map, read_photograph
from raden_torch.brdf.shading.relight import relight

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES, MODULES = ROOT / "examples", ROOT / "runtimes/node_modules"
SIZE, LAMP = 256, (0.36, 0.48, 0.8)
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")

needs_browser = pytest.mark.skipif(
    not (shutil.which("node") and CHROMIUM and (MODULES / "onnxruntime-web").is_dir()),
    reason="Node.js, Chromium or onnxruntime-web is not installed; make runtimes",
)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model, its exports, a simulated photograph and its normal map."""
    folder = tmp_path_factory.mktemp("relight")
    model = rt.fit(rt.simulate_specimen("yakogai"), interpolation="trilinear").model
    rt.save_model(model, folder / "shell.safetensors")
    rt.export_onnx(model, folder / "shell.onnx", fixed=True)
    y, x = np.mgrid[1 : -1 : SIZE * 1j, -1 : 1 : SIZE * 1j]
    radius = np.hypot(x, y)
    slope = 0.25 * np.cos(18 * radius) + 0.6 * radius
    normal = np.dstack([slope * x, slope * y, np.ones_like(x)])
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    inside = np.where(radius < 0.9, 255, 0)
    coded = np.rint(np.dstack([(normal[..., ::-1] + 1) * 127.5, inside])).astype(np.uint8)
    photo = np.dstack([40 + 20 * y, 30 + 10 * y, 90 + 40 * x]).round().astype(np.uint8)
    cv2.imwrite(str(folder / "normals.png"), coded)
    cv2.imwrite(str(folder / "photo.png"), photo)
    return folder


def library(scene: Path, lamp: tuple[float, float, float]) -> np.ndarray:
    """What `raden relight --exposure 0` shows, without its caption: RGB, 0…255."""
    model = rt.load_model(scene / "shell.safetensors")
    photo, normal = read_photograph(scene / "photo.png"), read_normal_map(scene / "normals.png")
    mask = (normal != 0).any(dim=1, keepdim=True).float()
    with torch.no_grad():
        relit = relight(model, photo.linear, normal, mask, [rt.DirectionalLight(lamp)], gain=1.0)
    return (to_display(relit)[0].movedim(0, -1) * 255).round().numpy().astype(int)


def check_same(picture: np.ndarray, scene: Path, lamp: tuple[float, float, float]) -> None:
    wanted = library(scene, lamp)
    assert wanted.max() > 150
    assert picture.shape == wanted.shape
    assert abs(picture - wanted).max() <= 1


def test_the_script_gives_the_librarys_picture(scene: Path) -> None:
    names = [scene / name for name in ("shell.onnx", "photo.png", "normals.png")]
    output = scene / "script.png"
    command = [sys.executable, EXAMPLES / "relight.py", *names, ",".join(map(str, LAMP)), output]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    check_same(cv2.imread(str(output))[..., ::-1].astype(int), scene, LAMP)
    text = (EXAMPLES / "relight.py").read_text("utf-8")
    assert set(re.findall(r"^import (\w+)", text, re.M)) == {"sys", "cv2", "numpy", "onnxruntime"}
    broken = [*command[:3], scene / "missing.png", *command[4:]]
    done = subprocess.run([str(c) for c in broken], capture_output=True, text=True, timeout=300)
    assert "missing.png: not a picture" in done.stderr


@pytest.fixture
def serve(scene: Path) -> Iterator[Callable[..., str]]:
    """Starts the page's server; gives the page's address."""
    started: list[subprocess.Popen[str]] = []

    def start(*options: str) -> str:
        command = ["node", str(EXAMPLES / "page/serve.mjs"), str(scene), "--port", "0", *options]
        server = subprocess.Popen(
            [*command, "--node-modules", str(MODULES)], stdout=subprocess.PIPE, text=True
        )
        started.append(server)
        return server.stdout.readline().strip()

    yield start
    for server in started:
        server.terminate()
        server.wait(10)
        server.stdout.close()


def visit(address: str, pictures: Path, **what: object) -> dict:
    visit = json.dumps({"url": address} | what)
    command = ["node", str(Path(__file__).with_name("visit.mjs")), str(MODULES), str(CHROMIUM)]
    done = subprocess.run(
        [*command, str(pictures), visit], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads((pictures / "page.json").read_text())
    shape = (found["height"], found["width"], 4)
    return found | {"picture": np.array(found.pop("pixels")).reshape(shape)[..., :3]}


@needs_browser
@pytest.mark.slow
def test_the_page_gives_the_librarys_picture(
    serve: Callable[..., str], scene: Path, tmp_path: Path
) -> None:
    at = [(LAMP[0] + 1) / 2, (1 - LAMP[1]) / 2]
    found = visit(serve(), tmp_path, pointer=at)
    assert found["message"] == ""
    assert re.match(r"\d+ pixels in \d+ ms, WebAssembly, [2-4] thread", found["state"])
    check_same(found["picture"], scene, LAMP)


@needs_browser
@pytest.mark.slow
def test_the_page_takes_webgpu_where_the_browser_has_it(
    serve: Callable[..., str], scene: Path, tmp_path: Path
) -> None:
    at = [(LAMP[0] + 1) / 2, (1 - LAMP[1]) / 2]
    found = visit(serve("--no-isolation"), tmp_path, pointer=at, graphics=True)
    assert found["message"] == ""
    assert re.match(r"\d+ pixels in \d+ ms, WebGPU", found["state"])
    check_same(found["picture"], scene, LAMP)


@needs_browser
@pytest.mark.slow
def test_the_page_without_isolation_runs_in_one_thread(
    serve: Callable[..., str], scene: Path, tmp_path: Path
) -> None:
    found = visit(serve("--no-isolation"), tmp_path, pointer=[0.5, 0.5])
    assert "without the headers COOP and COEP, so it runs in one thread" in found["message"]
    assert "1 thread" in found["state"]
    check_same(found["picture"], scene, (0.0, 0.0, 1.0))


@needs_browser
@pytest.mark.slow
def test_the_page_says_what_it_cannot_do(
    serve: Callable[..., str], scene: Path, tmp_path: Path
) -> None:
    address = serve()
    assert "no WebAssembly SIMD" in visit(address, tmp_path, noSimd=True)["message"]

    matt = rt.RadenBrdf(rt.load_model(scene / "shell.safetensors").diffuse, None)
    for name, options in (("scene", {"profile": "scene"}), ("brdf", {"output": "brdf"})):
        rt.export_onnx(matt, tmp_path / f"{name}.onnx", **options)
    (tmp_path / "text.onnx").write_text("not a model")
    for name, words in (
        ("scene", "the page needs “gbuffer”"),
        ("brdf", "the page needs “radiance”"),
        ("text", "not a model that onnxruntime-web can load"),
    ):
        found = visit(address, tmp_path, drop=str(tmp_path / f"{name}.onnx"))
        assert words in found["message"]
        assert found["picture"].max() > 150  # the picture with the old model stays

    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((4, 5, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "huge.png"), np.zeros((8000, 8000), np.uint8))
    found = visit(address, tmp_path, files={"photo": str(tmp_path / "small.png")})
    assert "must be of one size" in found["message"]
    found = visit(address, tmp_path, files={"photo": str(tmp_path / "huge.png")})
    assert "64 megapixels" in found["message"]
    found = visit(address, tmp_path, files={"photo": str(tmp_path / "text.onnx")})
    assert "not a picture" in found["message"]
