"""What the pages' examples take as given: files of the user's, tiny and simulated, and names."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

SIDE = 96
BLENDER = Path(__file__).parents[1] / "brdf/files/blender/shell_on_lacquer"


def ball() -> tuple[np.ndarray, np.ndarray]:
    """`[3, H, W]` normals of a sphere seen from +z, and where it is."""
    y, x = np.mgrid[1 : -1 : SIDE * 1j, -1 : 1 : SIDE * 1j].astype(np.float32)
    inside = x * x + y * y < 0.95
    z = np.sqrt(np.maximum(0, 1 - x * x - y * y))
    return np.where(inside, [x, y, z], 0).astype(np.float32), inside


def lambert(direction: np.ndarray) -> np.ndarray:
    """`[H, W, 3]` in 16 bits: a matt ball under a lamp in that direction."""
    light = direction / np.linalg.norm(direction)
    grey = np.clip(np.einsum("chw,c->hw", ball()[0], light), 0, 1)
    return (50_000 * np.stack([grey] * 3, -1)).astype(np.uint16)


def chrome(direction: np.ndarray) -> np.ndarray:
    """`[H, W, 3]` in 16 bits: a mirror ball, whose highlight stands where N is the half vector."""
    light = direction / np.linalg.norm(direction)
    half = light + np.array([0, 0, 1])
    near = np.einsum("chw,c->hw", ball()[0], half / np.linalg.norm(half))
    return (60_000 * np.stack([near > np.cos(0.04)] * 3, -1) + 500).astype(np.uint16)


def write_images(folder: Path) -> None:
    from raden_torch.images.exr import write_channels
    from raden_torch.images.pixels import write_pixels

    normal, inside = ball()
    layers = dict(zip(("N.X", "N.Y", "N.Z"), normal, strict=True))
    index = (np.arange(SIDE) * 3 // SIDE).astype(np.float32) * np.ones((SIDE, 1), np.float32)
    layers |= {"material": index, "IndexMA": index, "Z": np.where(inside, 6 - normal[2], np.inf)}
    for name in ("tangent", "grain"):
        along = np.stack([normal[2], 0 * normal[2], -normal[0]])
        layers |= dict(zip((f"{name}.X", f"{name}.Y", f"{name}.Z"), along, strict=True))
    for name in ("shot", "big"):
        write_channels(folder / f"{name}.exr", layers)
    ray = np.hypot.reduce(np.meshgrid(*2 * [np.linspace(-0.5, 0.5, SIDE)]))
    for name in ("depth", "z"):
        write_channels(folder / f"{name}.exr", {"Z": 5 * np.sqrt(1 + ray**2)})
    for name in ("room", "studio"):
        write_channels(folder / f"{name}.exr", {c: np.full((8, 16), 0.5) for c in "RGB"})
    for part in (".exr", ".json"):
        shutil.copy(BLENDER.with_suffix(part), folder / f"blender{part}")
    coded = np.rint(32_767.5 + 32_767.5 * np.moveaxis(normal, 0, -1)).astype(np.uint16)
    white = (255 * inside).astype(np.uint8)
    write_pixels(coded, folder / "n.png")
    for name in ("m", "ball", "box_mask"):
        write_pixels(white, folder / f"{name}.png")
    write_pixels(index.astype(np.uint8), folder / "map.png")
    turn = np.radians(np.arange(0, 360, 45))
    lamps = np.stack([np.sin(turn), np.cos(turn), 0 * turn + 1.5], -1)
    for number, lamp in enumerate(lamps):
        write_pixels(chrome(lamp), folder / f"chrome.{number}.png")
        write_pixels(lambert(lamp), folder / f"box.{number}.png")
    shutil.copy(folder / "box.0.png", folder / "box.png")


@pytest.fixture(scope="session")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files, by the names that the pages give them."""
    import raden_torch as rt
    from raden_torch.brdf.files.model_file import save_model
    from raden_torch.brdf.fitting.spectral_fit import fit_spectral
    from raden_torch.brdf.materials.palette import Palette

    folder = tmp_path_factory.mktemp("inputs")
    shells = {}
    for name in ("yakogai", "akoya", "abalone"):
        measured = rt.simulate_specimen(name, step_deg=35)
        shells[name] = rt.fit(measured).model
        save_model(shells[name], folder / f"{name}.safetensors")
        measured.save(folder / f"{name}.csv")
    for copy, name in {"shell": "yakogai", "other": "akoya"}.items():
        shutil.copy(folder / f"{name}.safetensors", folder / f"{copy}.safetensors")
    for copy, name in {"shell": "yakogai", "rim": "akoya", "middle": "yakogai"}.items():
        shutil.copy(folder / f"{name}.csv", folder / f"{copy}.csv")
    shutil.copy(folder / "abalone.csv", folder / "eye.csv")
    save_model(Palette(list(shells.values())), folder / "palette.safetensors")
    between = [[20.0, 20.0, 5.0], [10.0, -30.0, 15.0], [45.0, 50.0, -20.0]]
    rt.simulate_specimen("yakogai", geometries_deg=between).save(folder / "offgrid.csv")
    bands = rt.simulate_specimen("yakogai", step_deg=35, spectral=True)
    bands.save(folder / "bands.csv")
    save_model(fit_spectral(bands).model, folder / "bands.safetensors")
    rt.simulate_specimen("yakogai", step_deg=35, azimuth_deg=(0, 90)).save(folder / "turned.csv")
    nm = np.arange(380, 781, 10)
    lamp = "\n".join(f"{w},{1 + w / 1000}" for w in nm)
    (folder / "lamp.csv").write_text(f"wavelength_nm,power\n{lamp}\n", "utf-8")
    write_images(folder)
    np.save(folder / "normals.npy", ball()[0])
    scene = {"picture": "size = [32, 18]", "camera": "position = [1.5, 3.3, 5.8]\nfov_deg = 35.0"}
    text = "\n".join(f"[{table}]\n{lines}" for table, lines in scene.items())
    text += '\n[object]\nartwork = "none"\n[lights.environment]\nbuiltin = "room"\n'
    (folder / "scene.toml").write_text(text + "[animation]\nframes = 4\n", "utf-8")
    return folder


@pytest.fixture
def names(inputs: Path) -> dict[str, Any]:
    """What a page's Python fragments have in hand before they start."""
    import raden_torch as rt

    normal = torch.from_numpy(ball()[0])[None]
    camera = torch.tensor([0.0, 0.0, 6.0]).view(1, 3, 1, 1)
    lamp = rt.DirectionalLight((1, 1, 2))
    grey = torch.rand(1, 1, SIDE, SIDE)
    intrinsics = torch.tensor([[120.0, 0, 48], [0, 120, 48], [0, 0, 1]])
    return {
        "np": np,
        "torch": torch,
        "rt": rt,
        "model": rt.load_model(inputs / "yakogai.safetensors"),
        "normal": normal,
        "view": (camera - normal),
        "light": torch.tensor([1.0, 1.0, 2.0]).view(1, 3, 1, 1),
        "gbuffer": rt.GBuffer.from_depth(6 - normal[:, 2:], intrinsics),
        "lamp": lamp,
        "lights": [lamp],
        "density": grey,
        "depth": 5 + grey,
        "intrinsics": intrinsics,
        "index": torch.arange(SIDE).expand(1, 1, SIDE, SIDE) % 3,
        "chrome_photographs": sorted(inputs.glob("chrome.*.png")),
        "photographs": sorted(inputs.glob("box.[0-9].png")),
        "ball_mask": inputs / "ball.png",
        "mask": inputs / "box_mask.png",
    }
