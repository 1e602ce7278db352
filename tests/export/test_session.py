"""`ShaderSession`: the same picture as a plain call, whatever the mask and the tiles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import raden_torch as rt
from raden_torch.errors import InputError
from raden_torch.export.runtimes import onnx_session
from raden_torch.export.shader_session import ShaderSession


@pytest.fixture(scope="module")
def inputs() -> dict[str, np.ndarray]:
    draw = np.random.default_rng(0)
    shape = (2, 3, 20, 30)
    maps = {name: draw.standard_normal(shape, np.float32) for name in ("normal", "position")}
    maps["normal"][:, 2] += 2
    return maps | {
        "camera": np.array([[0, 0, 5], [1, 0, 5]], np.float32),
        "light": np.array([[0, 1, 2, 0], [1, 1, 4, 1], [-1, 1, 3, 1]], np.float32),
        "light_colour": np.ones((3, 3), np.float32),
    }


@pytest.fixture(scope="module")
def scene(exported: Callable, shell: rt.RadenBrdf) -> bytes:
    return exported(shell, profile="scene").path.read_bytes()


def same(a: np.ndarray, b: np.ndarray) -> bool:
    """Equal but for the last bit: other sizes, other vector instructions."""
    return a.shape == b.shape and np.allclose(a, b, rtol=1e-5, atol=1e-6 * np.abs(b).max(initial=0))


@pytest.mark.parametrize("tile", [1, 7, 100, 16384])
@pytest.mark.parametrize("share", [0.0, 0.1, 1.0])
def test_same_picture(scene: bytes, inputs: dict, tile: int, share: float) -> None:
    if tile == 1 and share == 1:
        pytest.skip("1200 calls show nothing more")
    mask = (np.random.default_rng(1).random((2, 1, 20, 30)) < share).astype(np.float32)
    mask[mask > 0] = 0.5
    whole = onnx_session(scene, threads=1).run(None, inputs | {"mask": mask})[0]
    session = ShaderSession(scene, tile=tile, threads=2)
    for _ in range(2):  # the buffers of the first call serve the second
        assert same(session.run(**inputs, mask=mask), whole)


def test_masks_of_one_image_and_odd_values(scene: bytes, inputs: dict) -> None:
    mask = np.ones((1, 1, 20, 30), np.float32)
    mask[..., :10], mask[..., 10:15], mask[..., 15:20] = np.nan, -1, 2
    whole = onnx_session(scene, threads=1).run(None, inputs | {"mask": mask})[0]
    assert same(ShaderSession(scene).run(**inputs, mask=mask), whole)
    assert same(ShaderSession(scene).run(**inputs, mask=mask > 1), whole * (mask > 1))


def test_other_parameters_and_no_pixels(scene: bytes, inputs: dict) -> None:
    session = ShaderSession(scene)
    half = session.run(**inputs, exposure=0.5)
    assert same(half, 0.5 * session.run(**inputs))
    empty = {k: v[:, :, :0] if v.ndim == 4 else v for k, v in inputs.items()}
    assert session.run(**empty).shape == (2, 3, 0, 30)


def test_one_light_for_all_pixels(exported: Callable, shell: rt.RadenBrdf, inputs: dict) -> None:
    session = ShaderSession(exported(shell, profile="gbuffer").path)
    light, view = np.ones((1, 3, 1, 1)), inputs["position"] + [[[[0]], [[0]], [[5]]]]
    one = session.run(normal=inputs["normal"], light=light, view=view)
    full = np.broadcast_to(light, view.shape)
    assert same(one, session.run(normal=inputs["normal"], light=full, view=view))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"normal": None}, "missing \\['normal'\\]"),
        ({"lights": np.ones(3)}, "unknown \\['lights'\\]"),
        ({"normal": np.ones((3, 4))}, "normal: expected shape .*, got \\[3, 4\\]"),
        ({"position": np.ones((2, 3, 20, 31))}, "position: expected shape .*, got"),
        ({"camera": np.ones((5, 3))}, "camera: expected shape .*, got"),
        ({"light": np.ones((3, 3))}, "light: expected shape .*, got"),
        ({"light_colour": np.ones((2, 3))}, "refused"),
    ],
)
def test_bad_input(scene: bytes, inputs: dict, change: dict, words: str) -> None:
    given = {k: v for k, v in (inputs | change).items() if v is not None}
    with pytest.raises(InputError, match=words):
        ShaderSession(scene).run(**given)


def test_bad_files(tmp_path) -> None:
    with pytest.raises(InputError, match="No such file"):
        ShaderSession(tmp_path / "missing.onnx")
    with pytest.raises(InputError, match="cannot load it"):
        ShaderSession(b"not a model")
    with pytest.raises(InputError, match="at least 1 pixel"):
        ShaderSession(b"", tile=0)
