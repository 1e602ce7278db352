"""Makes real_time.png, a sphere by torch, WebGL 2 and WebGPU, and viewer.jpg, at two widths.

python docs/pictures/real_time.py runtimes/node_modules     (a minute)
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import torch

import raden_torch as rt
from raden_torch.brdf.files.display import to_display
from raden_torch.brdf.shading.sphere_gbuffer import sphere
from raden_torch.export.shading_language import export_shader
from raden_torch.export.shading_language_check import draw_shader
from raden_torch.export.viewer_file import export_viewer

HERE = Path(__file__).resolve().parent
LIGHT = (0.5, 0.5, 0.7)
SIZE, TIMES = 300, 50
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--hide-scrollbars",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--virtual-time-budget=8000",
)


def shown(f: torch.Tensor, cosine: torch.Tensor) -> np.ndarray:
    """f_r `[1, 3, H, W]` under a lamp of irradiance 2π, as 8-bit BGR."""
    picture = to_display(f * cosine.clamp(min=0) * 2 * torch.pi)[0]
    return (picture.movedim(0, -1).numpy()[..., ::-1] * 255).round().astype(np.uint8)


def side_by_side(model: rt.RadenBrdf, folder: Path, modules: Path) -> np.ndarray:
    ball = sphere(SIZE, (0.0, 0.0, 6.0), samples=1)
    light = torch.nn.functional.normalize(torch.tensor(LIGHT), dim=0).view(1, 3, 1, 1)
    view = torch.nn.functional.normalize(torch.tensor([0.0, 0.0, 6.0]).view(1, 3, 1, 1), dim=1)
    normal, light, view = torch.broadcast_tensors(ball.normal, light, view)
    cosine = (normal * light).sum(1, keepdim=True)
    with torch.no_grad():
        pictures = {"shade": shown(model(normal, light, view), cosine)}
    for suffix, name in ((".glsl", "WebGL 2"), (".wgsl", "WebGPU")):
        path = folder / f"shell{suffix}"
        export_shader(model, path)
        drawn = draw_shader(path, normal, light, view, node_modules=modules)
        pictures[name] = shown(drawn, cosine)
    for name in ("WebGL 2", "WebGPU"):
        off = np.abs(pictures[name].astype(int) - pictures["shade"]) * TIMES
        pictures[f"{name}: difference x {TIMES}"] = off.clip(0, 255).astype(np.uint8)
    return np.hstack([captioned(picture, name) for name, picture in pictures.items()])


def captioned(picture: np.ndarray, text: str) -> np.ndarray:
    high = cv2.copyMakeBorder(picture, 0, 28, 4, 4, cv2.BORDER_CONSTANT, value=(20, 20, 20))
    place = (8, picture.shape[0] + 20)
    cv2.putText(high, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (220, 220, 220), 1, cv2.LINE_AA)
    return high


def screenshots(model: rt.RadenBrdf, folder: Path) -> np.ndarray:
    page = folder / "shell.html"
    export_viewer(model, page)
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    assert browser, "expected Chromium on the path"
    found = []
    for width, height in ((1100, 860), (400, 860)):
        target = folder / f"{width}.png"
        command = [browser, *FLAGS, f"--user-data-dir={folder / str(width)}"]
        command += [f"--screenshot={target}", f"--window-size={width},{height}", page.as_uri()]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        found.append(cv2.imread(str(target)))
    return np.hstack([found[0], np.zeros_like(found[0][:, :12]), found[1]])


if __name__ == "__main__":
    yakogai = rt.fit(rt.simulate_specimen("yakogai")).model
    with tempfile.TemporaryDirectory() as made:
        compared = side_by_side(yakogai, Path(made), Path(sys.argv[1]))
        cv2.imwrite(str(HERE / "real_time.png"), compared)
        cv2.imwrite(str(HERE / "viewer.jpg"), screenshots(yakogai, Path(made)))
