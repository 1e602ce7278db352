"""A headless Chromium that a module's tests share, and what the library draws of the same scene."""

from __future__ import annotations

import base64
import json
import math
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.display import to_display

MODULES = Path(__file__).resolve().parents[2] / "runtimes/node_modules"
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
EYE, HALF_HEIGHT = (0.0, 0.0, 3.4), 0.36
LAMP = math.sin(0.45) * math.cos(0.35), math.sin(0.35), math.cos(0.45) * math.cos(0.35)
"""As the viewer has it at first."""

needs_browser = pytest.mark.skipif(
    not (shutil.which("node") and CHROMIUM and (MODULES / "playwright-core").is_dir()),
    reason="Node.js, Chromium or playwright-core is not installed; make runtimes",
)


class Browser:
    """What a page shows at first and after each step, without errors and without a network."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.replies: list[Any] = []

    def visit(
        self, page: Path, *steps: Any, width: int = 400, scale: float = 0.5, **more: Any
    ) -> Any:
        what = {"page": str(page), "width": width, "height": 900, "scale": scale, "steps": steps}
        assert self.process.stdin
        assert self.process.stdout
        self.process.stdin.write(json.dumps(what | more) + "\n")
        self.process.stdin.flush()
        found = json.loads(self.process.stdout.readline())
        assert found["errors"] == []
        outside = [u for u in found["requests"] if not u.startswith(("file:", "data:", "about:"))]
        assert outside == []
        self.replies = found["replies"]
        return found["seen"]


@contextmanager
def opened() -> Iterator[Browser]:
    command = ["node", str(Path(__file__).with_name("view.mjs")), str(MODULES), str(CHROMIUM)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield Browser(process)
        assert process.stdin
        process.stdin.close()
        process.wait(timeout=60)


def pixels(url: str) -> np.ndarray:
    coded = np.frombuffer(base64.b64decode(url.split(",", 1)[1]), np.uint8)
    return cv2.imdecode(coded, cv2.IMREAD_UNCHANGED)[..., 2::-1].astype(int)


def sphere_by_shade(
    model: rt.RadenBrdf,
    width: int,
    height: int,
    lights: Any = None,
    *,
    eye: tuple[float, float, float] = EYE,
    half: tuple[float, float] = (HALF_HEIGHT, HALF_HEIGHT),
    stops: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """A unit sphere at the origin seen along −z, in 0…255, and where it is, away from its rim.

    Args:
        half: the picture's half sizes at distance 1 from the eye.
    """
    x = ((torch.arange(width, dtype=torch.float64) + 0.5) / width * 2 - 1) * half[0]
    y = -((torch.arange(height, dtype=torch.float64) + 0.5) / height * 2 - 1) * half[1]
    y, x = torch.meshgrid(y, x, indexing="ij")
    ray = torch.nn.functional.normalize(torch.stack([x, y, -torch.ones_like(x)])[None], dim=1)
    start = torch.tensor(eye, dtype=torch.float64).view(1, 3, 1, 1)
    along = -(ray * start).sum(1, keepdim=True)
    inside = along**2 - (start**2).sum() + 1
    position = start + ray * (along - inside.clamp(min=0).sqrt())
    normal = torch.where(inside > 0, position, 0.0).float()
    gbuffer = rt.GBuffer(normal, position=position.float(), camera=eye)
    with torch.no_grad():
        image = rt.shade(model, gbuffer, lights or rt.DirectionalLight(LAMP))
    picture = (to_display(image * 2**stops)[0].movedim(0, -1) * 255).round().numpy().astype(int)
    return picture, -(normal * ray.float()).sum(1)[0].numpy() > 0.2
