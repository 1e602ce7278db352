"""A small model, and G-buffers and photographs of several frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.image_file import Photograph, write_photograph
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.images.exr import write_channels

H, W = 24, 32


def normals(number: int, height: int = H, width: int = W) -> np.ndarray:
    """`[3, H, W]` unit vectors that lean further in every frame."""
    generator = np.random.default_rng(number)
    n = generator.normal(0, 0.1, (3, height, width))
    n[0] += 0.05 * (number % 10)
    n[2] += 1
    return n / np.linalg.norm(n, axis=0)


@pytest.fixture
def model_file(tmp_path: Path) -> Path:
    path = tmp_path / "matt.safetensors"
    diffuse = CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.ones(3))
    rt.save_model(rt.RadenBrdf(diffuse, None), path)
    return path


@pytest.fixture
def shots(tmp_path: Path) -> Callable[..., Path]:
    """Writes G-buffers of these frames; returns their pattern."""

    def write(*numbers: int, height: int = H, width: int = W, **more: np.ndarray) -> Path:
        for number in numbers:
            n = normals(number, height, width)
            channels = dict(zip(("N.X", "N.Y", "N.Z"), n, strict=True)) | more
            write_channels(tmp_path / f"shot.{number:04d}.exr", channels)
        return tmp_path / "shot.####.exr"

    return write


@pytest.fixture
def photographs(tmp_path: Path) -> Callable[..., Path]:
    """Writes photographs of these frames, and a normal map for each and for all."""

    def write(*numbers: int, height: int = H, width: int = W) -> Path:
        for number in numbers:
            photo = torch.rand(
                (1, 3, height, width), generator=torch.Generator().manual_seed(number)
            )
            write_photograph(Photograph(0.2 + 0.5 * photo, 255), tmp_path / f"box.{number:04d}.png")
            coded = torch.from_numpy((normals(number, height, width) + 1) / 2)[None].float()
            for name in (f"normal.{number:04d}.png", "normal.png"):
                write_photograph(Photograph(coded, 65535), tmp_path / name, coded="linear")
        return tmp_path / "box.####.png"

    return write
