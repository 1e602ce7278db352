"""Normal maps that are stored otherwise than they are read: what they say, and when they do not."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from scipy import ndimage

from raden_torch.artwork.plate import plate
from raden_torch.brdf.files.gbuffer_file import GBufferFile, read_gbuffer
from raden_torch.brdf.files.image_file import read_normal_map
from raden_torch.brdf.files.normal_axes import NormalAxes
from raden_torch.brdf.files.normal_check import _curls, warn_of_normals
from raden_torch.brdf.shading.sphere_gbuffer import sphere
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels

SIZE = 96


def ball() -> np.ndarray:
    """`[3, H, W]` of a ball seen from afar, 0 around it."""
    y, x = np.mgrid[1 : -1 : SIZE * 1j, -1 : 1 : SIZE * 1j] / 0.9
    z2 = 1 - x * x - y * y
    return np.stack([x, y, np.sqrt(z2.clip(0))]) * (z2 > 0)


def of_height(h: np.ndarray) -> np.ndarray:
    up, across = np.gradient(h)
    n = np.stack([-across, up, np.ones_like(h)])  # rows go down
    return n / np.linalg.norm(n, axis=0)


def bumps(slope: float = 0.4, size_px: float = 5.0, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    h = ndimage.gaussian_filter(rng.normal(size=(SIZE, SIZE)), size_px, mode="wrap")
    return of_height(h * slope / np.gradient(h)[0].std())


SURFACES = {"ball": ball(), "bumps": bumps(), "shallow": bumps(0.08), "fine": bumps(0.5, 1.5)}


def stored_as(n: np.ndarray, xyz: str) -> np.ndarray:
    """The channels of a map that has to be read with `xyz`."""
    axes, channels = NormalAxes.of(xyz), np.empty_like(n)
    for k, (channel, sign) in enumerate(zip(axes.channels, axes.signs, strict=True)):
        channels[channel] = sign * n[k]
    return channels


def write_png(path: Path, channels: np.ndarray, levels: int = 255) -> Path:
    coded = (channels + 1) / 2 * (channels != 0).any(axis=0)
    return write_coded(path, coded, levels)


def write_coded(path: Path, coded: np.ndarray, levels: int = 255) -> Path:
    kind = np.uint8 if levels == 255 else np.uint16
    pixels = np.rint(coded * levels).astype(kind).transpose(1, 2, 0)[..., ::-1]
    assert cv2.imwrite(str(path), np.ascontiguousarray(pixels))
    return path


def named(channels: np.ndarray) -> dict[str, np.ndarray]:
    return {f"N.{c}": n for c, n in zip("XYZ", channels, strict=True)}


# --- the curl, by hand


def test_the_curl_of_a_known_surface():
    """h = x²/2 + a x y + b y²/2 has p_x = 1, p_y = q_x = a, q_y = b everywhere. Expected: c of the
    four arrangements is 0, 4a²/E, (b − 1)²/E, (b + 1)²/E with E = 1 + 2a² + b²."""
    a, b = 0.7, -0.4
    y, x = np.mgrid[1:-1:65j, -1:1:65j]
    n = torch.from_numpy(np.stack([-(x + a * y), -(a * x + b * y), np.ones_like(x)]))[None]
    curls = next(_curls(n, torch.ones(1, 65, 65, dtype=torch.bool), 1e-3))
    energy = 1 + 2 * a**2 + b**2
    expected = np.array([0, 4 * a**2, (b - 1) ** 2, (b + 1) ** 2]) / energy
    np.testing.assert_allclose(curls, expected, atol=1e-12)


@pytest.mark.parametrize("text", ["r,g", "r,g,g", "x,y,z", "--r,g,b", "", "r;g;b"])
def test_axes_that_are_none(text):
    with pytest.raises(InputError, match=r"normal xyz: expected the channels of x,y,z, .*, got"):
        NormalAxes.of(text)


def test_axes():
    v = torch.tensor([1.0, 2, 3]).view(1, 3, 1, 1)
    assert NormalAxes.of("b,-r,g").of_map(v).flatten().tolist() == [3, -1, 2]
    assert NormalAxes.of("r,-g,b") == NormalAxes.of(green="directx")
    assert NormalAxes.of("r,-g,b", "directx") == NormalAxes()
    assert str(NormalAxes.of(" R, +G,-b")) == "r,g,-b"


# --- every arrangement is found, and the option that is named mends it


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize(
    "xyz", ["r,-g,b", "g,r,b", "b,g,r", "r,b,g", "r,g,-b", "r,-g,-b", "g,b,r", "g,-r,b"]
)
def test_the_option_that_is_named_mends_the_map(tmp_path, name, xyz):
    path = write_png(tmp_path / "n.png", stored_as(SURFACES[name], xyz))
    with pytest.warns(UserWarning, match=r"n\.png: .*if so, give") as found:
        read_normal_map(path)
    assert len(found) == 1
    option = re.search(r"--normal-xyz=(\S+)\)", str(found[0].message)).group(1)
    mended = read_normal_map(path, xyz=option)[0].numpy()
    there = (SURFACES[name] != 0).any(axis=0)
    assert np.abs(mended - SURFACES[name])[:, there].max() < 0.02


def test_what_is_said(tmp_path):
    path = write_png(tmp_path / "n.png", stored_as(ball(), "r,-g,b"))
    with pytest.warns(UserWarning, match=r"green turned around.*\(--green directx\)"):
        read_normal_map(path)
    read_normal_map(path, "directx")
    path = write_png(tmp_path / "n.png", ball())
    with pytest.warns(UserWarning, match=r"green turned around.*\(--green opengl\)"):
        read_normal_map(path, "directx")
    path = write_png(tmp_path / "n.png", -ball())
    with pytest.warns(UserWarning, match=r"seen from behind or edge-on; .*=-r,-g,-b\)"):
        read_normal_map(path)  # its outline tells it from "r,g,-b"
    lost = np.stack(
        [np.zeros((SIZE, SIZE)), np.full((SIZE, SIZE), 0.8), np.full((SIZE, SIZE), -0.6)]
    )
    lost[1, ::2] *= -1  # no channel faces the viewer
    lost[2, ::3] *= -0.5
    with pytest.warns(
        UserWarning,
        match="y up, z to the viewer, got 67% of the normals facing away from the viewer",
    ):
        read_normal_map(write_png(tmp_path / "n.png", lost / np.linalg.norm(lost, axis=0)))


@pytest.mark.parametrize("levels", [255, 65535, None])
def test_noise_hides_it_from_pixels_but_not_from_their_means(levels):
    rng = np.random.default_rng(3)
    n = torch.from_numpy(
        stored_as(bumps(0.4, 9.0), "r,-g,b") + 0.06 * rng.normal(size=(3, SIZE, SIZE))
    )
    with pytest.warns(UserWarning, match="green turned around"):
        warn_of_normals("m", n[None].float(), NormalAxes(), is_coded=levels is not None)


def test_exr_layers(tmp_path):
    path = tmp_path / "n.exr"
    write_channels(path, named(stored_as(ball(), "r,-g,-b")))  # as OpenCV's camera has it
    with pytest.warns(
        UserWarning, match="green and blue turned around .*--normal-xyz=r,-g,-b"
    ) as w:
        read_gbuffer(path)
    assert len(w) == 1
    np.testing.assert_allclose(read_gbuffer(path, xyz="r,-g,-b").normal[0], ball(), atol=1e-6)
    normal = read_normal_map(path, "directx", xyz="r,g,-b")
    np.testing.assert_allclose(normal[0], ball(), atol=1e-6)
    read_gbuffer(path, view=(0, 0, -1))  # in a frame of their own, they face the viewer
    in_bands = GBufferFile(path, memory=96 * 32 * 400)
    assert len(in_bands.bands) > 1
    with pytest.warns(UserWarning, match="r,-g,-b") as w:
        [in_bands.rows(*band) for band in in_bands.bands]
    assert len(w) == 1


def test_large_maps_are_seen_in_places(tmp_path):
    n = np.tile(bumps(), (1, 4, 5))
    with pytest.warns(UserWarning, match="green turned around"):
        read_normal_map(write_png(tmp_path / "n.png", stored_as(n, "r,-g,b")))
    read_normal_map(write_png(tmp_path / "n.png", n))


# --- lengths


def srgb(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def linear(coded: np.ndarray) -> np.ndarray:
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


CODED = (bumps() + 1) / 2
GREY = np.stack([ndimage.gaussian_filter(np.random.default_rng(1).random((SIZE, SIZE)), 4)] * 3)


@pytest.mark.parametrize(
    ("coded", "said"),
    [
        (srgb(CODED), "would be without the sRGB curve: save the map as linear"),
        (linear(CODED), "would be with the sRGB curve: the map was decoded as a colour"),
        (bumps().clip(0), r"expected \(n \+ 1\)/2, got what seems to be n cut off at 0"),
        (
            (GREY - GREY.min()) / np.ptp(GREY),
            "expected a normal map, got a grey image, perhaps a height map",
        ),
        (np.stack([*CODED[:2], np.full((SIZE, SIZE), 0.5)]), "as if x and y alone were stored"),
        (np.random.default_rng(2).random((3, SIZE, SIZE)) * 0.9, "a picture, not a normal map?"),
    ],
)
def test_lengths_tell_what_a_map_is(tmp_path, coded, said):
    path = write_coded(tmp_path / "n.png", coded)
    with pytest.warns(UserWarning, match=rf"n\.png: \d+% of the normals are not of.*{said}"):
        read_normal_map(path)


def test_a_map_without_z(tmp_path):
    path = write_coded(tmp_path / "n.png", CODED * np.array([1, 1, 0])[:, None, None])
    with pytest.warns(
        UserWarning, match="expected x, y and z, got only x and y \\(blue is 0 everywhere\\)"
    ):
        read_normal_map(path)


def test_float_maps_with_some_values_below_0(tmp_path):
    coded = CODED.copy()
    coded[:, 5, 5] = -0.03  # a resampling filter's undershoot
    pixels = np.ascontiguousarray(coded.transpose(1, 2, 0)[..., ::-1].astype(np.float32))
    cv2.imwrite(str(tmp_path / "n.tiff"), pixels)
    with pytest.warns(UserWarning, match=r"stored as \(n \+ 1\)/2, with some values below 0"):
        read_normal_map(tmp_path / "n.tiff")
    long = 3 * bumps()
    warn_of_normals("m", torch.from_numpy(long)[None], NormalAxes(), is_coded=False)


# --- no false alarm


def check(n: torch.Tensor | np.ndarray) -> None:
    """As it is and in 8 bits; a warning is an error here."""
    n = torch.as_tensor(n).float().reshape(1, 3, *n.shape[-2:])
    n = torch.nn.functional.normalize(n, dim=1)
    warn_of_normals("m", n, NormalAxes(), is_coded=False)
    there = (n != 0).any(dim=1, keepdim=True)
    coarse = (2 * torch.round((n + 1) / 2 * 255) / 255 - 1) * there
    warn_of_normals("m", coarse, NormalAxes(), is_coded=True, step=2 / 255)


def test_the_project_s_own_shapes_are_as_they_are():
    for camera in ((0, 0, 6), (0, 0, 2), (1.5, 1, 3)):
        check(sphere(SIZE, camera, samples=1).normal)
    layers = plate(128, (0, -2.4, 4.2), samples=1)
    check(layers.shell.normal)
    check(layers.lacquer.normal)


def test_surfaces_with_and_without_noise_are_as_they_are():
    rng = np.random.default_rng(4)
    y, x = np.mgrid[-1 : 1 : SIZE * 1j, -1 : 1 : SIZE * 1j]
    for k in range(8):
        a, b, c = rng.normal(size=3)
        heights = {
            "bowl": x * x + y * y,
            "saddle": x * y,
            "quadric": a * x * x + b * y * y + c * x * y,
            "ridges": np.sin(8 * (a * x + b * y)),
        }
        normals = [of_height(h * SIZE / 2 * rng.uniform(0.02, 0.5)) for h in heights.values()]
        normals.append(bumps(np.exp(rng.uniform(-5, 0.5)), np.exp(rng.uniform(0, 3)), seed=k))
        normals.append(np.stack([0 * x, 0 * x, 0 * x + 1]))  # flat
        for n in normals:
            check(n)
            check(n + rng.normal(size=n.shape) * np.exp(rng.uniform(-6, -0.5)))


def test_perspective_is_no_curl():
    """Rationale: seen through a wide lens the slopes are not quite a height's. Expected: a ball off
    the axis under 90° is no other arrangement, though a part of its rim has z < 0."""
    slope = np.tan(np.deg2rad(45)) * np.linspace(-1, 1, SIZE)
    ray = np.stack([*np.meshgrid(slope, -slope), -np.ones((SIZE, SIZE))])
    for centre in ((0, 0, -4), (2, 1, -4), (-2.5, 2.5, -4)):
        c = np.array(centre)[:, None, None]
        a, b = (ray * ray).sum(axis=0), (ray * c).sum(axis=0)
        inside = b * b - a * ((c * c).sum() - 1.5**2)
        away = np.where(inside > 0, (b - np.sqrt(inside.clip(0))) / a, np.nan) * ray - c
        check(np.nan_to_num(away))


def test_real_maps_are_as_they_are(shared):
    """A renderer's, and a real ball's by photographs: its noise leaves the curl half as large."""
    from raden_torch.capture.photo.ball import ball_from_mask
    from raden_torch.capture.photo.highlight import find_highlight
    from raden_torch.capture.photo.lamps import lamps_from_balls
    from raden_torch.capture.photo.photometric_stereo import solve_normals

    read_gbuffer(shared / "data" / "gbuffer" / "normals.exr")
    folder = shared / "data" / "photometric_stereo"
    chrome = ball_from_mask(cv2.imread(str(folder / "chrome.mask.png"), cv2.IMREAD_GRAYSCALE))
    seen = [cv2.imread(str(folder / f"chrome.{k}.png")) / 255 for k in range(12)]
    lamps = lamps_from_balls([chrome], [[find_highlight(image, chrome)] for image in seen])
    lights = torch.from_numpy(lamps.direction)
    for name in ("gray", "buddha"):
        photos = np.stack([cv2.imread(str(folder / f"{name}.{k}.png")) for k in range(12)])
        mask = cv2.imread(str(folder / f"{name}.mask.png"), cv2.IMREAD_GRAYSCALE) > 127
        images = torch.from_numpy(photos).movedim(-1, 1).float() / 255
        found = solve_normals(
            images, lights, torch.from_numpy(mask)[None, None].float(), method="least-squares"
        )
        check(found.normal)
        turned = NormalAxes.of("r,-g,b").of_map(found.normal).float()
        with pytest.warns(UserWarning, match="green turned around"):
            warn_of_normals("m", turned, NormalAxes(), is_coded=False)
        with warnings.catch_warnings(record=True) as swapped:
            warnings.simplefilter("always")
            warn_of_normals("m", found.normal.flip(1).float(), NormalAxes(), is_coded=False)
        assert "--normal-xyz=b,g,r" in str(swapped[0].message)
