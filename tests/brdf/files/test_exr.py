"""OpenEXR: named channels there and back, G-buffers from them, and files that are wrong."""

from __future__ import annotations

import contextlib
import math
import struct
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import raden_torch as rt
from raden_torch.brdf.files.exr_tensors import read_colour, write_image
from raden_torch.brdf.files.gbuffer_file import read_gbuffer
from raden_torch.brdf.files.normal_coding import Evidence, decoded
from raden_torch.errors import InputError
from raden_torch.images import exr_file
from raden_torch.images.exr import (
    list_channels,
    read_channels,
    read_parts,
    write_channels,
    write_parts,
)
from raden_torch.images.exr_file import ExrFile

OpenEXR = pytest.importorskip("OpenEXR")

H, W = 12, 16
RAMP = np.arange(H * W, dtype=np.float32).reshape(H, W)


def bumps(height: int = H, width: int = W) -> np.ndarray:
    """`[3, H, W]` unit normals of a waved plane that faces +z."""
    y, x = np.mgrid[:height, :width]
    n = np.stack([0.5 * np.sin(x / 2.0), 0.4 * np.cos(y / 3.0), np.ones((height, width))])
    return (n / np.linalg.norm(n, axis=0)).astype(np.float32)


def named(layer: str, letters: str, vectors: np.ndarray) -> dict[str, np.ndarray]:
    dot = f"{layer}." if layer else ""
    return {dot + letter: v for letter, v in zip(letters, vectors, strict=True)}


def write_raw(path: Path, header: dict, channels: dict, name: str = "") -> Path:
    """A file with a header that `write_parts` does not write."""
    base = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File([OpenEXR.Part({**base, **header}, channels, name)]).write(str(path))
    return path


def with_window(data: bytes, name: bytes, corners: tuple[int, int, int, int]) -> bytes:
    """The file with another window claimed in its header."""
    start = data.index(name + b"\0box2i\0") + len(name) + 7 + 4
    return data[:start] + struct.pack("<4i", *corners) + data[start + 16 :]


# --- channels there and back


def test_floats_and_halves_come_back_exactly(tmp_path):
    values = np.random.default_rng(0).normal(size=(H, W)).astype(np.float32)
    values[0, :3] = np.inf, -np.inf, np.nan
    write_channels(tmp_path / "f.exr", {"Z": values, "any name.x": RAMP})
    back = read_channels(tmp_path / "f.exr")
    assert set(back) == {"Z", "any name.x"} == set(list_channels(tmp_path / "f.exr"))
    np.testing.assert_array_equal(back["Z"], values)
    assert all(a.dtype == np.float32 for a in back.values())
    write_channels(tmp_path / "h.exr", {"Z": values}, half=True)
    half = read_channels(tmp_path / "h.exr")["Z"]
    np.testing.assert_array_equal(half, values.astype(np.float16).astype(np.float32))
    assert [p.name for p in sorted(tmp_path.iterdir())] == ["f.exr", "h.exr"]


def test_whole_numbers_tiles_and_a_single_pixel(tmp_path):
    ids = write_raw(tmp_path / "u.exr", {}, {"id": RAMP.astype(np.uint32)})
    np.testing.assert_array_equal(read_channels(ids)["id"], RAMP)
    tiles = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    np.testing.assert_array_equal(
        read_channels(write_raw(tmp_path / "t.exr", tiles, {"Z": RAMP}))["Z"], RAMP
    )
    write_channels(tmp_path / "1.exr", {"Z": [[7]]})
    assert read_channels(tmp_path / "1.exr")["Z"].tolist() == [[7.0]]


def test_parts_and_their_names(tmp_path):
    path = tmp_path / "m.exr"
    parts = {
        "rgba": named("", "RGBA", np.stack([RAMP] * 4)),
        "normal": named("", "RGB", bumps()),
        "extra": {"Z": RAMP},
    }
    write_parts(path, parts)
    assert sorted(list_channels(path)) == sorted(
        [*(f"rgba.{c}" for c in "RGBA"), *(f"normal.{c}" for c in "RGB"), "Z"]
    )
    assert {name: set(channels) for name, channels in read_parts(path).items()} == {
        name: set(channels) for name, channels in parts.items()
    }
    np.testing.assert_array_equal(read_channels(path)["normal.G"], bumps()[1])


@pytest.mark.parametrize(
    ("data", "expected"),
    [((2, 3), RAMP), ((-4, -2), RAMP[2:, 4:]), ((10, 5), RAMP[:11, :10])],
    ids=["inside", "above left", "below right"],
)
def test_the_data_window_is_placed_in_the_display_window(tmp_path, data, expected):
    x, y = data
    windows = {
        "dataWindow": ((x, y), (x + W - 1, y + H - 1)),
        "displayWindow": ((0, 0), (19, 15)),
    }
    z = read_channels(write_raw(tmp_path / "w.exr", windows, {"Z": RAMP}))["Z"]
    assert z.shape == (16, 20)
    rows, columns = expected.shape
    top, left = max(y, 0), max(x, 0)
    np.testing.assert_array_equal(z[top : top + rows, left : left + columns], expected)
    assert z.sum() == expected.sum()


# --- what is wrong is said in one line


def fails(path: Path, *words: str, read=read_channels) -> None:
    with pytest.raises(InputError) as caught:
        read(path)
    message = str(caught.value)
    assert "\n" not in message
    for word in (str(path), *words):
        assert word in message


def test_missing_foreign_and_empty_files(tmp_path, capfd):
    fails(tmp_path / "none.exr", "No such file")
    fails(tmp_path, "got a folder")
    for data in (b"", b"\x89PNG\r\n\x1a\n" + bytes(99)):
        (tmp_path / "x.exr").write_bytes(data)
        fails(tmp_path / "x.exr", "expected an OpenEXR file, got one that starts with")
        fails(
            tmp_path / "x.exr",
            "expected an OpenEXR file, got one that starts with",
            read=list_channels,
        )
    (tmp_path / "x.exr").write_bytes(b"\x76\x2f\x31\x01" + bytes(99))
    fails(tmp_path / "x.exr", "damaged")
    write_channels(tmp_path / "x.exr", {"N.X": RAMP})
    data = (tmp_path / "x.exr").read_bytes()
    (tmp_path / "x.exr").write_bytes(data.replace(b"N.X\0", b"N\xe3X\0"))
    fails(tmp_path / "x.exr", "UTF-8")
    assert capfd.readouterr() == ("", "")  # OpenEXR itself is kept quiet


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> tuple[Path, bytes]:
    """A place to write to, and a small multi-part file."""
    path = tmp_path_factory.mktemp("exr") / "small.exr"
    write_parts(path, {"a": {"Z": RAMP, "N.X": RAMP}, "b": {"Z": RAMP * 2}})
    return path, path.read_bytes()


@settings(max_examples=150, deadline=None)
@given(share=st.floats(0, 1, exclude_max=True))
def test_a_truncated_file_is_an_input_error(small, share):
    path, data = small
    path.write_bytes(data[: int(share * len(data))])
    fails(path)


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_noise_in_the_pixels_is_read_or_an_input_error(small, data):
    path, whole = small
    start = len(whole) // 2  # well behind the headers
    noisy = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 8))):
        noisy[data.draw(st.integers(start, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(noisy)
    with contextlib.suppress(InputError):
        assert all(a.shape == (H, W) for a in read_channels(path).values())


@pytest.mark.parametrize(
    ("window", "side", "words"),
    [
        (b"dataWindow", 2**20, ("1048577x1048577",)),  # OpenImageIO refuses it itself
        (b"dataWindow", 2**13, ("dataWindow", f"1…{exr_file.MAX_PIXELS} pixels")),
        (b"dataWindow", 2**17, ("claims a 65537 MB image",)),
        (b"displayWindow", 2**20, ("isplay resolution 1048577x1048577",)),
        (b"displayWindow", 2**18, ("displayWindow", f"1…{exr_file.MAX_PIXELS} pixels")),
    ],
)
def test_an_enormous_window_is_refused_before_memory_is_taken(
    tmp_path, window, side, words, monkeypatch
):
    path = tmp_path / "big.exr"
    write_channels(path, {"Z": RAMP})
    data = path.read_bytes()
    path.write_bytes(with_window(data, window, (0, 0, side, side)))
    monkeypatch.setattr(ExrFile, "read", None)
    fails(path, *words)
    monkeypatch.setattr(exr_file, "MAX_VALUES", RAMP.size - 1)
    path.write_bytes(data)
    fails(path, "values in all channels")


def test_windows_apart_and_upside_down(tmp_path):
    path = tmp_path / "w.exr"
    write_channels(path, {"Z": RAMP})
    data = path.read_bytes()
    path.write_bytes(with_window(data, b"displayWindow", (100, 100, 120, 120)))
    fails(path, "overlaps the display window")
    path.write_bytes(with_window(data, b"dataWindow", (0, 0, -5, 9)))
    fails(path)


def test_deep_and_subsampled_channels(tmp_path):
    deep = np.empty((2, 2), dtype=object)
    for i in np.ndindex(2, 2):
        deep[i] = np.array([1, 2], np.float32)
    kind = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    fails(write_raw(tmp_path / "deep.exr", kind, {"Z": deep}), "deep")
    path = write_raw(tmp_path / "sub.exr", {}, {"RY": RAMP})
    data = path.read_bytes()
    start = data.index(b"RY\0") + 3 + 8  # after the pixel type and the flags
    path.write_bytes(data[:start] + struct.pack("<2i", 2, 2) + data[start + 8 :])
    fails(path, '"RY"', "Subsampled channels are not supported", "2,2")


def test_parts_of_differing_size(tmp_path):
    path = tmp_path / "m.exr"
    with pytest.raises(InputError, match=r"a\.Z 12 x 16, b\.Z 2 x 16"):
        write_parts(path, {"a": {"Z": RAMP}, "b": {"Z": RAMP[:2]}})
    assert not path.exists()
    write_parts(path, {"a": {"Z": RAMP}, "b": {"Z": RAMP}})
    path.write_bytes(with_window(path.read_bytes(), b"displayWindow", (0, 0, 9, 9)))
    fails(path, "Part 1 (b) has non-conforming shared attributes: displayWindow")


@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"": {}},
        {"": {"Z": RAMP[0]}},
        {"": {"Z": RAMP[:0]}},
        {"": {"Z": RAMP * 1j}},
        {"": {"": RAMP}},
        {"": {"Z": RAMP}, "b": {"Z": RAMP}},
    ],
    ids=["no part", "no channel", "flat", "empty", "complex", "no name", "part without a name"],
)
def test_what_cannot_be_written(tmp_path, parts):
    with pytest.raises(InputError, match=r"x\.exr: "):
        write_parts(tmp_path / "x.exr", parts)
    assert not list(tmp_path.iterdir())


# --- which channels are what


@pytest.mark.parametrize(
    ("layer", "letters"),
    [
        ("N", "XYZ"),
        ("Normal", "XYZ"),
        ("normals", "RGB"),
        ("normal", "xyz"),
        ("NormalWorld", "rgb"),
        ("ViewLayer.Normal", "XYZ"),
    ],
)
def test_normals_by_their_usual_names(tmp_path, layer, letters):
    beauty = named("", "RGB", np.stack([RAMP] * 3))
    write_channels(tmp_path / "n.exr", {**named(layer, letters, bumps()), **beauty})
    gbuffer = read_gbuffer(tmp_path / "n.exr")
    assert gbuffer.normal.dtype == torch.float32
    np.testing.assert_array_equal(gbuffer.normal[0].numpy(), bumps())
    assert gbuffer.view.flatten().tolist() == [0, 0, 1]
    assert bool((gbuffer.mask == 1).all())
    colour = read_colour(tmp_path / "n.exr")
    np.testing.assert_array_equal(colour[0, 1].numpy(), RAMP)


def test_layers_and_channels_named_by_the_caller(tmp_path):
    path = tmp_path / "n.exr"
    flat = np.zeros((3, H, W), np.float32)
    flat[2] = 1
    write_channels(
        path,
        {
            **named("N", "XYZ", flat),
            **named("MyLayer", "XYZ", bumps()),
            **dict(zip(("nx", "ny", "nz"), bumps(), strict=True)),
            "Z2": RAMP + 1,
            "holdout.v": (RAMP > 5).astype(np.float32),
        },
    )
    for layer in ("MyLayer", "mylayer", "nx, ny, nz"):
        gbuffer = read_gbuffer(path, channels={"normal": layer, "mask": "holdout"})
        np.testing.assert_array_equal(gbuffer.normal[0].numpy(), bumps())
        np.testing.assert_array_equal(gbuffer.mask[0, 0].numpy(), RAMP > 5)
    gbuffer = read_gbuffer(path, channels={"depth": "Z2"}, fov_deg=60)
    np.testing.assert_array_equal(-gbuffer.position[0, 2].numpy(), RAMP + 1)


def test_a_channel_that_is_not_there_lists_those_that_are(tmp_path):
    path = tmp_path / "n.exr"
    write_channels(path, {"foo": RAMP, **named("bar", "XYZ", bumps())})
    for wanted in (None, {"normal": "foo"}, {"normal": "a,b,c"}, {"depth": "Z"}):
        with pytest.raises(InputError, match=r"n\.exr: .*bar\.X, bar\.Y, bar\.Z, foo"):
            read_gbuffer(path, channels=wanted)
    with pytest.raises(InputError, match="normal, position, depth, mask"):
        read_gbuffer(path, channels={"normals": "bar"})
    write_channels(path, {**named("l.N", "XYZ", bumps()), **named("r.N", "XYZ", bumps())})
    with pytest.raises(
        InputError, match=r"normal: expected one layer that may be it, not l\.n, r\.n,"
    ):
        read_gbuffer(path)


def test_multi_part_layers_are_found_by_the_names_of_their_parts(tmp_path):
    path = tmp_path / "m.exr"
    alpha = np.where(RAMP > 9, 1, 0.5)
    write_parts(
        path,
        {
            "rgba": named("", "RGBA", np.stack([RAMP, RAMP, RAMP, alpha])),
            "normal": named("", "XYZ", bumps()),
            "depth": {"Z": np.full((H, W), 4.0)},
        },
    )
    gbuffer = read_gbuffer(path)
    np.testing.assert_array_equal(gbuffer.normal[0].numpy(), bumps())
    np.testing.assert_array_equal(gbuffer.mask[0, 0].numpy(), alpha)
    np.testing.assert_array_equal(read_colour(path)[0, 0].numpy(), RAMP)


@pytest.mark.parametrize("levels", [None, 255, 65535])
def test_coded_normals_are_decoded(levels):
    n = torch.from_numpy(bumps())[None]
    coded = (n + 1) / 2
    if levels is not None:
        coded = (coded * levels).round() / levels
    coded[..., 0, :2] = torch.tensor([[0.0, 0.5]]).expand(3, 2)[None]  # black and grey: none
    back = decoded(coded, Evidence.of(coded).is_coded)
    assert bool((back[..., 0, :2] == 0).all())
    assert float((back - n)[..., 1:, :].abs().max()) <= 1.01 / (levels or 1e7)


def test_normals_that_are_not_coded_stay(tmp_path):
    octant = torch.from_numpy(np.abs(bumps()))[None]  # none negative, all unit
    for n in (octant, 3 * torch.from_numpy(bumps())[None], torch.zeros(1, 3, 2, 2)):
        assert torch.equal(decoded(n, Evidence.of(n).is_coded), n)
    n = torch.from_numpy(bumps())[None].clone()
    n[0, 0, 0, 0], n[0, :, 0, 1] = math.nan, 0
    write_channels(tmp_path / "n.exr", named("N", "XYZ", n[0].numpy()))
    gbuffer = read_gbuffer(tmp_path / "n.exr")
    assert gbuffer.mask[0, 0, 0, :3].tolist() == [0, 0, 1]
    assert bool(torch.isfinite(gbuffer.normal).all())


@pytest.mark.parametrize("code", [False, True])
def test_a_bare_rgb_of_unit_vectors_is_normals(tmp_path, code):
    path = tmp_path / "n.exr"
    n = bumps()
    write_channels(path, named("", "RGB", (n + 1) / 2 if code else n))
    np.testing.assert_allclose(read_gbuffer(path).normal[0].numpy(), n, atol=1e-6)
    assert read_colour(path) is None


def test_a_picture_of_pure_colours_is_no_normal_map(tmp_path):
    path = tmp_path / "n.exr"
    pure = np.zeros((3, H, W), np.float32)
    pure[0, :, :5] = pure[1, :, 5:10] = pure[2, :, 10:] = 1
    write_channels(path, named("", "RGB", pure))
    with pytest.raises(InputError, match="expected normals or a depth, got the channels"):
        read_gbuffer(path)
    np.testing.assert_array_equal(read_colour(path)[0].numpy(), pure)


# --- where the viewer is


def test_positions_and_a_camera(tmp_path):
    path = tmp_path / "n.exr"
    position = np.stack([RAMP, -RAMP, np.zeros_like(RAMP)])
    write_channels(path, {**named("N", "XYZ", bumps()), **named("P", "XYZ", position)})
    gbuffer = read_gbuffer(path, camera=(0, 0, 5))
    view = gbuffer.view_map(gbuffer.normal)
    np.testing.assert_array_equal(view[0].numpy(), np.array([0, 0, 5])[:, None, None] - position)
    assert read_gbuffer(path).position is not None
    assert read_gbuffer(path, view=(1, 0, 1)).view.flatten().tolist() == [1, 0, 1]
    with pytest.raises(InputError, match="expected view or camera, got both"):
        read_gbuffer(path, camera=(0, 0, 5), view=(0, 0, 1))
    write_channels(path, named("N", "XYZ", bumps()))
    with pytest.raises(InputError, match="camera: expected positions with it"):
        read_gbuffer(path, camera=(0, 0, 5))


def test_a_pinhole_sees_the_corner_pixels_under_its_angle(tmp_path):
    path = tmp_path / "n.exr"
    write_channels(path, named("N", "XYZ", bumps()))
    view = read_gbuffer(path, fov_deg=90).view[0]
    # the outer edge of the outer pixel lies at 45°, half a pixel beyond its centre
    assert view[0, 0, 0] == pytest.approx((W - 1) / W)  # at the left, the camera is to the right
    assert view[1, 0, 0] == pytest.approx(-(H - 1) / W)  # at the top, it is below
    assert bool((view[2] == 1).all())
    focal = W / 2
    matrix = [[focal, 0, (W - 1) / 2], [0, focal, (H - 1) / 2], [0, 0, 1]]
    torch.testing.assert_close(read_gbuffer(path, intrinsics=matrix).view[0], view)


def test_normals_and_depth_make_positions(tmp_path):
    path = tmp_path / "n.exr"
    write_channels(path, {**named("N", "XYZ", bumps()), "Z": RAMP})
    assert read_gbuffer(path).position is None  # no pinhole, no positions
    gbuffer = read_gbuffer(path, fov_deg=90)
    assert gbuffer.camera == (0.0, 0.0, 0.0)
    assert gbuffer.mask[0, 0, 0, :2].tolist() == [0, 1]
    expected = torch.tensor([(W - 1) / W, -(H - 1) / W, -1]) * RAMP[-1, -1]
    torch.testing.assert_close(gbuffer.position[0, :, -1, -1], expected)
    assert read_gbuffer(path, fov_deg=90, view=(1, 0, 1)).view.flatten().tolist() == [1, 0, 1]
    with pytest.raises(InputError, match="at 0, 0, 0"):
        read_gbuffer(path, fov_deg=90, camera=(0, 0, 1))


def plane(slope_x: float, slope_y: float, fov_deg: float) -> tuple[np.ndarray, torch.Tensor]:
    """Depth `[H, W]` of the plane z = −4 + slope·(x, y), y up, and its normal `[3]`."""
    f = W / 2 / math.tan(math.radians(fov_deg) / 2)
    y, x = np.mgrid[:H, :W]
    ray_x, ray_y = (x - (W - 1) / 2) / f, -(y - (H - 1) / 2) / f
    depth = 4 / (1 + slope_x * ray_x + slope_y * ray_y)
    normal = torch.tensor([-slope_x, -slope_y, 1.0])
    return depth.astype(np.float32), normal / normal.norm()


def test_depth_becomes_normals_with_y_up(tmp_path):
    path = tmp_path / "z.exr"
    depth, expected = plane(0.5, -0.3, 40)
    write_channels(path, {"Depth.V": depth})
    gbuffer = read_gbuffer(path, fov_deg=40)
    inner = gbuffer.normal[0, :, 1:-1, 1:-1]
    torch.testing.assert_close(inner, expected.view(3, 1, 1).expand_as(inner), atol=1e-3, rtol=0)
    x, y, z = gbuffer.position[0]
    torch.testing.assert_close(z, -4 + 0.5 * x - 0.3 * y, atol=1e-5, rtol=0)
    assert gbuffer.camera == (0.0, 0.0, 0.0)
    smooth = read_gbuffer(path, fov_deg=40, smooth_px=1.0).normal[0, :, 4:-4, 4:-4]
    torch.testing.assert_close(smooth, expected.view(3, 1, 1).expand_as(smooth), atol=2e-2, rtol=0)


def test_where_nothing_is_there_is_no_depth(tmp_path):
    path = tmp_path / "z.exr"
    depth, expected = plane(0.0, 0.0, 40)
    depth[0, :6] = 1e10, 65504, np.inf, np.nan, 0, -1
    depth[5:, :4] = 0
    write_channels(path, {"Z": depth, "A": np.where(RAMP > 180, 0.25, 1)})
    gbuffer = read_gbuffer(path, fov_deg=40)
    assert not gbuffer.mask[0, 0, 0, :6].any()
    assert not gbuffer.mask[0, 0, 5:, :4].any()
    assert gbuffer.mask[0, 0, -1, -1] == 0.25
    there = gbuffer.mask[0, 0] > 0
    # the silhouette's normals are the plane's own
    assert float((gbuffer.normal[0, :, there] - expected[:, None]).abs().max()) < 1e-3
    assert bool(torch.isfinite(gbuffer.position).all())


def test_depth_needs_a_camera(tmp_path):
    path = tmp_path / "z.exr"
    write_channels(path, {"Z": RAMP + 1})
    with pytest.raises(InputError, match="give `fov_deg` or intrinsics"):
        read_gbuffer(path)
    for wrong in ({"fov_deg": 180}, {"intrinsics": np.zeros((3, 3))}, {"intrinsics": np.eye(2)}):
        with pytest.raises(InputError, match=r"z\.exr: `?(fov_deg|intrinsics)`?: expected .*got"):
            read_gbuffer(path, **wrong)
    with pytest.raises(InputError, match="expected intrinsics or fov_deg, got both"):
        read_gbuffer(path, fov_deg=40, intrinsics=np.eye(3))
    with pytest.raises(InputError, match="at 0, 0, 0"):
        read_gbuffer(path, fov_deg=40, camera=(0, 0, 1))
    with pytest.raises(InputError, match="smooth_px"):
        read_gbuffer(path, fov_deg=40, smooth_px=math.nan)
    write_channels(path, {"Z": -RAMP})
    with pytest.raises(InputError, match="expected a valid pixel, got none above 0"):
        read_gbuffer(path, fov_deg=40)


def test_steps_of_half_precision_depth_are_warned_of(tmp_path):
    y, x = np.mgrid[:64, :64]
    depth = 9 + 0.01 * x + 0.003 * y
    write_channels(tmp_path / "h.exr", {"Z": depth}, half=True)
    write_channels(tmp_path / "f.exr", {"Z": depth})
    with pytest.warns(UserWarning, match="half precision"):
        read_gbuffer(tmp_path / "h.exr", fov_deg=5)
    read_gbuffer(tmp_path / "h.exr", fov_deg=5, smooth_px=2)
    read_gbuffer(tmp_path / "f.exr", fov_deg=5)


# --- images


def test_an_image_is_written_scene_linear_in_halves(tmp_path):
    image = torch.rand(1, 3, H, W) * 8 - 1
    image[0, 0, 0, 0] = 1e9
    write_image(image, tmp_path / "x.exr")
    back = read_colour(tmp_path / "x.exr")
    assert torch.equal(back, image.clamp(max=65504).half().float())
    with pytest.raises(InputError, match=r"\[1, 3, H, W\]"):
        write_image(image[0], tmp_path / "x.exr")


# --- real files


def shaded(model, gbuffer, *direction: float) -> torch.Tensor:
    with torch.no_grad():
        image = rt.shade(model, gbuffer, rt.DirectionalLight(direction))
    assert bool(torch.isfinite(image).all())
    return image


def test_a_renderers_normals_are_shaded(shared, analytic):
    path = shared / "data" / "gbuffer" / "normals.exr"
    model = rt.fit(analytic(), interpolation="trilinear", outside="diffuse").model
    far = read_gbuffer(path)
    assert far.normal.shape == (1, 3, 64, 64)
    assert int((far.mask == 0).sum()) == 247  # Mitsuba wrote 0 where no ray hit
    back_wall = shaded(model, far, 0, 0, 1)[0, :, 24, 30]
    assert bool((back_wall > 0.05).all())
    # The room's left wall faces right. A camera at infinity sees it edge-on, a pinhole does not.
    near = read_gbuffer(path, fov_deg=39.3)
    assert float(far.normal[0, 0, 30, 3]) > 0.999
    edge_on = float(shaded(model, far, 1, 0, 1)[0, :, 30, 3].sum())
    assert float(shaded(model, near, 1, 0, 1)[0, :, 30, 3].sum()) > 20 * edge_on
    assert float(shaded(model, near, -1, 0, 1)[0, :, 30, 3].sum()) == 0
    # the floor faces up
    assert float(shaded(model, near, 0, 1, 0.5)[0, :, 62, 30].sum()) > 0
    assert read_colour(path) is None


def test_albedo_and_noise_are_no_normals(shared):
    for name in ("albedo.exr", "noisy.exr"):
        path = shared / "data" / "gbuffer" / name
        with pytest.raises(InputError, match="channels B, G, R"):
            read_gbuffer(path)
        assert read_colour(path).shape == (1, 3, 64, 64)


def test_a_ball_is_relit_through_its_depth(shared, analytic):
    path = shared / "data" / "gbuffer" / "singlepart.0001.exr"
    model = rt.fit(analytic(), interpolation="trilinear").model
    gbuffer = read_gbuffer(path, fov_deg=54, smooth_px=4)
    assert gbuffer.normal.shape == (1, 3, 1556, 2048) == read_colour(path).shape
    there = gbuffer.mask[0, 0] > 0
    normal = gbuffer.normal[0][:, there]
    assert float((normal.norm(dim=0) - 1).abs().max()) < 1e-5
    assert bool(((normal * -gbuffer.position[0][:, there]).sum(dim=0) > 0).all())
    # the ball's left half looks left, its upper half up
    # (measured where it is opaque: it moves, and its blurred rim blends two depths)
    y, x = torch.nonzero(gbuffer.mask[0, 0] == 1, as_tuple=True)
    opaque = gbuffer.normal[0, :, y, x]
    assert torch.corrcoef(torch.stack([opaque[0], x.float()]))[0, 1] > 0.95
    assert torch.corrcoef(torch.stack([opaque[1], -y.float()]))[0, 1] > 0.95
    middle = int(x.float().mean())
    image = shaded(model, gbuffer, -1, 0, 1)
    assert float(image[..., :middle].sum()) > 1.5 * float(image[..., middle:].sum())
    assert float(image[0][:, ~there].sum()) == 0


def test_a_small_file_may_not_claim_a_huge_empty_picture(tmp_path: Path) -> None:
    path = tmp_path / "sparse.exr"
    write_channels(path, {"Z": np.ones((48, 48), np.float32)})
    data = path.read_bytes()
    at = data.index(b"displayWindow\0box2i\0") + len(b"displayWindow\0box2i\0") + 4
    for rows in (48, 4800, 524336):
        window = struct.pack("<4i", 0, 0, 47, rows - 1)
        path.write_bytes(data[:at] + window + data[at + 16 :])
        if rows > 5000:
            fails(path, "at least 1/4096 of the display window, got 2304 pixels in 48 x 524336")
        else:
            assert read_channels(path)["Z"].shape == (rows, 48)
