"""Simulated photographs of a sphere, a plane and a cylinder of analytic BRDF: a small ray caster of
its own, in NumPy, without the package's geometry. Frame: x right, y up, z to the viewer."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest

Array = np.ndarray
Y_DOWN = np.array([1.0, -1.0, -1.0])


def unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def shell(normal: Array, light: Array, view: Array, width: float = 0.12) -> Array:
    """`[P, 3]` f_r in 1/sr of a simulated shell: a matt body, and a coloured lobe around the
    mirror, isotropic and reciprocal."""
    half = unit(light + view)
    miss = np.linalg.norm(np.cross(normal, half), axis=1)
    lobe = np.exp(-((miss / width) ** 2) / 2)
    bend = np.arctan2(np.linalg.norm(np.cross(light, view), axis=1), (light * view).sum(1))
    colour = 1 + 0.5 * np.cos(bend[:, None] * 2 + np.array([0.0, 1.5, 3.0]))
    return (np.array([0.3, 0.35, 0.32]) + 0.9 * lobe[:, None] * colour) / np.pi


def node_truth(nodes_deg: Array, brdf: Callable[..., Array] = shell) -> Array:
    """`[M, 3]` reflectance factors at raden angles: N is z; L and V lie in a plane that leans by
    the tilt, on either side of N's projection."""
    a, r, t = np.radians(nodes_deg).T
    light = np.stack([-np.sin(a), -np.cos(a) * np.sin(t), np.cos(a) * np.cos(t)], 1)
    view = np.stack([np.sin(r), -np.cos(r) * np.sin(t), np.cos(r) * np.cos(t)], 1)
    normal = np.broadcast_to([0.0, 0.0, 1.0], light.shape)
    return 100 * np.pi * brdf(normal, light, view)


def lamp_ring(count: int, seed: int = 0) -> Array:
    """`[count, 3]` directions from 10 to 115 degrees off the camera's axis, on all sides."""
    k = np.arange(count)
    away = np.radians(10 + 105 * (k + 0.5) / count)
    turn = 2.4 * k + seed
    return np.stack([np.sin(away) * np.cos(turn), np.sin(away) * np.sin(turn), np.cos(away)], 1)


@dataclass
class Series:
    """Simulated photographs in a folder, with the files of the earlier steps."""

    folder: Path
    photos: list[Path]
    lights: Path
    mask: Path
    white: Path
    lamps: Array
    extra: dict[str, object] = field(default_factory=dict)


def write_lights(
    path: Path, direction: Array, intensity: Array, position: Array | None = None, unit_: str = "px"
) -> None:
    rows = [
        {"photograph": f"ball{k}.png", "direction_to_lamp": d.tolist(), "intensity": float(i)}
        | ({} if position is None else {f"position_{unit_}": position[k].tolist()})
        for k, (d, i) in enumerate(zip(direction, intensity, strict=True))
    ]
    content = {"format": "raden capture", "version": 1, "kind": "lights", "made_from": []}
    content |= {"unit": unit_, "response_exponent": 1.0, "lamps": rows}
    path.write_text(json.dumps(content))


def write_photo(path: Path, linear: Array) -> None:
    stored = np.clip(np.rint(linear * 65535), 0, 65535).astype(np.uint16)
    cv2.imwrite(str(path), stored[..., ::-1])


@pytest.fixture
def sphere_series(tmp_path: Path) -> Callable[..., Series]:
    """Photographs of a sphere by a far camera; beside it a white card faces the camera."""

    def make(
        count: int = 12,
        *,
        radius: float = 150.0,
        near: float | None = None,
        noise: float = 0.002,
        outliers: float = 0.0,
        brdf: Callable[..., Array] = shell,
        lamps: Array | None = None,
        power: Array | None = None,
        exposure: float = 0.25,
        moved: dict[int, tuple[float, float]] | None = None,
        lamp_error_deg: float = 0.0,
        seed: int = 0,
        name: str = "s",
    ) -> Series:
        folder = tmp_path / name
        folder.mkdir()
        random = np.random.default_rng(seed)
        side = int(2 * radius + 60)
        size = side, side + 80
        centre = np.array([side / 2 + 0.3, side / 2 - 0.2])
        y, x = np.mgrid[: size[0], : size[1]].astype(float)
        direction = lamp_ring(count) if lamps is None else lamps
        count = len(direction)
        power = np.ones(count) if power is None else power
        middle = np.array([centre[0], -centre[1], radius])
        position = None if near is None else middle + near * radius * direction
        photos = []
        for k in range(count):
            shift = (moved or {}).get(k, (0.0, 0.0))
            dx, dy = x - centre[0] - shift[0], -(y - centre[1] - shift[1])
            z = np.sqrt(np.clip(radius**2 - dx**2 - dy**2, 0, None))
            on = z > 0
            point = np.stack([dx + centre[0], dy - centre[1], z], -1)
            card = (x > side + 10) & (y > 20) & (y < side - 20)
            linear = np.full((*size, 3), 0.004)
            for where, normal in ((on, np.stack([dx, dy, z], -1) / radius), (card, None)):
                p = (
                    point[where]
                    if normal is not None
                    else np.stack([x, -y, 0 * x + radius], -1)[where]
                )
                n = normal[where] if normal is not None else np.broadcast_to([0.0, 0, 1], p.shape)
                to = np.broadcast_to(direction[k], p.shape)
                fall = np.ones(len(p))
                if position is not None:
                    to = position[k] - p
                    fall = ((position[k] - middle) ** 2).sum() / (to**2).sum(1)
                    to = unit(to)
                lit = np.clip((n * to).sum(1), 0, None) * fall * power[k]
                view = np.broadcast_to([0.0, 0, 1], p.shape)
                f = brdf(n, to, view) if normal is not None else np.full((len(p), 3), 0.9 / np.pi)
                linear[where] = np.pi * f * lit[:, None] * exposure
            linear = cv2.GaussianBlur(linear, (0, 0), 0.5)
            linear = linear + noise * np.sqrt(linear + 0.01) * random.normal(size=linear.shape)
            if outliers:
                bad = random.random(size) < outliers
                linear[bad] = random.choice([0.0, 0.9], bad.sum())[:, None]
            photos.append(folder / f"photo{k}.png")
            write_photo(photos[-1], linear)
        lean = np.radians(lamp_error_deg) * random.normal(size=direction.shape)
        said = unit(direction + lean)
        reach = None if position is None else middle + near * radius * said
        write_lights(folder / "lights.json", said, power / power.mean(), reach)
        on = np.hypot(x - centre[0], y - centre[1]) < radius
        cv2.imwrite(str(folder / "mask.png"), 255 * on.astype(np.uint8))
        card = (x > side + 10) & (y > 20) & (y < side - 20)
        cv2.imwrite(str(folder / "white.png"), 255 * card.astype(np.uint8))
        return Series(
            folder, photos, folder / "lights.json", folder / "mask.png", folder / "white.png",
            direction,
        )  # fmt: skip

    return make


def sphere_setup(series: Series) -> dict[str, object]:
    """The arguments of `capture_brdf` for such a series."""
    from raden_torch.capture.photo.brdf.reference_place import WhiteSpec
    from raden_torch.capture.photo.brdf.sample import SampleSpec
    from raden_torch.capture.photo.brdf.white import D65_XYZ, WhiteFactor
    from raden_torch.capture.photo.capture_brdf import Setup
    from raden_torch.capture.photo.development import Development

    return {
        "photographs": series.photos,
        "setup": Setup(series.lights, development=Development("linear"), lamp_std_deg=0.1),
        "sample": SampleSpec("sphere", series.mask),
        "white": WhiteSpec(series.white),
        "factor": WhiteFactor(0.9 * D65_XYZ),
    }
