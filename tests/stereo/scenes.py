"""Simulated photographs of a shell of analytic BRDF and of film optics: a small caster of its own,
in NumPy, without the package's geometry. Frame: x right, y up, z to the viewer, who is far away."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from raden_torch.capture.photo.lamps import Lamps, write_lamps
from raden_torch.stereo.observed_light import ObservedLight

Array = np.ndarray
VIEW = np.array([0.0, 0.0, 1.0])


def unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def shell(normal: Array, light: Array, turn: float = 0.0) -> Array:
    """`[P, 3]` f_r in 1/sr: a matt body and two lobes whose colour changes with the angle."""
    half = unit(light + VIEW)
    miss = np.linalg.norm(np.cross(normal, half), axis=-1)[..., None]
    bend = np.arccos(np.clip(light @ VIEW, -1, 1))[..., None]
    colour = 1 + 0.5 * np.cos(2 * bend + turn + np.array([0.0, 1.5, 3.0]) + 3 * miss)
    lobes = 0.9 * np.exp(-((miss / 0.12) ** 2) / 2) + 0.5 * np.exp(-((miss / 0.35) ** 2) / 2)
    return (np.array([0.15, 0.18, 0.16]) + lobes * colour) / np.pi


@dataclass(frozen=True)
class Shell:
    """The same formula in torch, as a material."""

    turn: float = 0.0

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        return torch.float32

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        half = torch.nn.functional.normalize(l + v, dim=1)
        miss = torch.linalg.cross(n.expand_as(half), half, dim=1).norm(dim=1, keepdim=True)
        bend = torch.arccos((l * v).sum(1, keepdim=True).clamp(-1, 1))
        phase = torch.tensor([0.0, 1.5, 3.0]).view(1, 3, 1, 1)
        colour = 1 + 0.5 * torch.cos(2 * bend + self.turn + phase + 3 * miss)
        lobes = 0.9 * torch.exp(-((miss / 0.12) ** 2) / 2)
        lobes = lobes + 0.5 * torch.exp(-((miss / 0.35) ** 2) / 2)
        body = torch.tensor([0.15, 0.18, 0.16]).view(1, 3, 1, 1)
        above = ((n * l).sum(1, keepdim=True) > 0) & ((n * v).sum(1, keepdim=True) > 0)
        return (body + lobes * colour) / torch.pi * above


def lamps_around(count: int) -> Array:
    """`[count, 3]`: 15 to 65 degrees from the camera's axis, on all sides."""
    k = np.arange(count)
    away, turn = np.radians(15 + 50 * (0.618 * k % 1)), 2 * np.pi * k / count + 0.3 * (k % 2)
    return np.stack([np.sin(away) * np.cos(turn), np.sin(away) * np.sin(turn), np.cos(away)], 1)


def sphere(side: int) -> tuple[Array, Array]:
    """Normals `[H, W, 3]` and where they are."""
    x = (np.arange(side) + 0.5) / side * 2.1 - 1.05
    y, x = np.meshgrid(-x, x, indexing="ij")
    square = x * x + y * y
    return np.stack([x, y, np.sqrt(np.clip(1 - square, 0, None))], -1), square < 0.95


def off_deg(found: Tensor, true: Array) -> Array:
    """Between `[3, P]` and `[P, 3]` unit vectors."""
    a = found.double().numpy().T
    near = np.linalg.norm(np.cross(a, true), axis=1)
    return np.degrees(np.arctan2(near, (a * true).sum(1)))


def write_lights(path: Path, lamps: Array) -> None:
    names = tuple(f"photo{k:02d}.png" for k in range(len(lamps)))
    write_lamps(Lamps(lamps, np.ones(len(lamps)), names=names), path)


def write_photographs(folder: Path, linear: Array) -> list[Path]:
    """`[K, H, W, 3]` as PNGs of 16 bits."""
    paths = [folder / f"photo{k:02d}.png" for k in range(len(linear))]
    for path, picture in zip(paths, linear, strict=True):
        stored = np.clip(np.rint(picture * 65535), 0, 65535).astype(np.uint16)
        cv2.imwrite(str(path), stored[..., ::-1])
    return paths


@dataclass(frozen=True)
class Scene:
    """A simulated sphere: `[K, H, W, 3]` photographs, lamps, true normals and mask."""

    linear: Array
    lamps: Array
    normal: Array
    mask: Array

    @property
    def true(self) -> Array:
        return self.normal[self.mask]

    @property
    def light(self) -> ObservedLight:
        value = torch.tensor(self.linear[:, self.mask]).movedim(-1, 1).float()
        count = len(value)
        usable = (value < 1).all(1, keepdim=True).float()
        to = torch.tensor(self.lamps).float()[:, :, None]
        view = torch.tensor([[0.0], [0.0], [1.0]])
        return ObservedLight(value, usable, to, torch.ones(count, 1, 1), view, 0.002)

    def write(self, folder: Path) -> list[Path]:
        write_lights(folder / "lights.json", self.lamps)
        cv2.imwrite(str(folder / "mask.png"), 255 * self.mask.astype(np.uint8))
        return write_photographs(folder, self.linear)


def photographed(normal: Array, mask: Array, lamps: Array, brdf, noise: float = 0.002) -> Array:
    """`[K, H, W, 3]` linear, the brightest hundredth clipped."""
    rng = np.random.default_rng(len(lamps))
    linear = np.zeros((len(lamps), *normal.shape))
    for lamp, picture in zip(lamps, linear, strict=True):
        facing = (normal @ lamp).clip(0) * mask
        lit = facing > 1e-3
        to = np.broadcast_to(lamp, (lit.sum(), 3))
        picture[lit] = brdf(normal[lit], to) * facing[lit][:, None]
    linear = linear * 0.95 / np.quantile(linear[:, mask].max(-1), 0.99)
    linear += noise * np.sqrt(abs(linear) + 0.01) * rng.normal(size=linear.shape)
    return linear.clip(0, 1)
