"""The display transform against colour-science, and the files as other readers take them."""

from __future__ import annotations

import io
from pathlib import Path

import colour
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageCms

from raden_torch.brdf.files.display import Display, key_exposure_ev, srgb_coded, to_display
from raden_torch.brdf.files.gamut import into_gamut, oklab
from raden_torch.brdf.files.image_file import read_photograph
from raden_torch.brdf.files.tone import aces, neutral
from raden_torch.colorimetry import ACESCG, DISPLAY_P3, SRGB, between
from raden_torch.errors import InputError
from raden_torch.images.exr_file import ExrFile

SPACES = {"srgb": "sRGB", "display-p3": "Display P3", "acescg": "ACEScg"}


def pixels(values: object) -> torch.Tensor:
    """`[N, 3]` → `[1, 3, 1, N]`."""
    return torch.as_tensor(np.asarray(values)).double().T[None, :, None]


def hue_error_deg(before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    """Of colours with chroma left: the angle between their a, b in Oklab."""
    a, b = (torch.complex(*oklab(x)[0, 1:].unbind(0)).flatten() for x in (before, after))
    kept = b.abs() > 0.02
    return torch.rad2deg((a / b).angle().abs())[kept]


def iridescent(count: int = 4000) -> torch.Tensor:
    """Bright spectral colours, as films of rising thickness show them: half are out of gamut."""
    generator = np.random.default_rng(3)
    phase = generator.uniform(0, 2 * np.pi, (count, 1)) * [1.0, 1.2, 1.45]
    rgb = generator.uniform(0.2, 0.6, (count, 1)) * (1 + 1.3 * np.cos(phase))
    return pixels(rgb)


@pytest.mark.parametrize("space", ["display-p3", "acescg"])
def test_primaries_are_those_of_colour_science(space: str) -> None:
    ours = between(SRGB, {"display-p3": DISPLAY_P3, "acescg": ACESCG}[space])
    theirs = colour.matrix_RGB_to_RGB(
        colour.RGB_COLOURSPACES["sRGB"], colour.RGB_COLOURSPACES[SPACES[space]], "Bradford"
    )
    assert np.abs(ours - theirs).max() < 3e-4


def test_oklab_is_that_of_colour_science() -> None:
    rgb = np.random.default_rng(0).uniform(-0.1, 2.0, (200, 3))
    theirs = colour.XYZ_to_Oklab(rgb @ colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ.T)
    assert np.abs(oklab(pixels(rgb))[0, :, 0].T.numpy() - theirs).max() < 1e-3


def test_srgb_curve_is_that_of_colour_science() -> None:
    x = torch.linspace(0, 1, 1001, dtype=torch.float64)
    assert np.abs(srgb_coded(x).numpy() - colour.models.eotf_inverse_sRGB(x.numpy())).max() < 1e-6


def test_gamut_mapping_keeps_hue_and_lightness_where_clipping_shifts_them() -> None:
    light = iridescent()
    mapped = into_gamut(light)
    assert mapped.min() >= 0
    assert mapped.max() <= 1
    out = ((light < 0) | (light > 1)).any(1).flatten()
    assert 0.2 < out.double().mean() < 0.95
    assert torch.equal(mapped[..., ~out], light[..., ~out])
    kept, cut = (hue_error_deg(light, x) for x in (mapped, light.clamp(0, 1)))
    assert kept.max() < 0.01
    assert cut.max() > 20
    assert cut.mean() > 100 * kept.mean()
    lightness = [oklab(x)[0, 0].clamp(0, 1) for x in (light, mapped)]
    assert (lightness[0] - lightness[1]).abs().max() < 2e-3


def test_gamut_mapping_takes_no_more_chroma_than_needed() -> None:
    """What is mapped touches the gamut's surface."""
    light = iridescent()
    out = ((light < -1e-3) | (light > 1 + 1e-3)).any(1).flatten()
    mapped = into_gamut(light)[..., out]
    bright = (oklab(light)[0, 0, 0, out] > 0.999) | (oklab(light)[0, 0, 0, out] < 0.05)
    room = torch.minimum(mapped.amin(1), 1 - mapped.amax(1)).flatten()
    assert room[~bright].max() < 2e-3


@given(st.lists(st.floats(-100, 1e4, width=32), min_size=3, max_size=3))
def test_every_finite_colour_becomes_one_that_is_shown(rgb: list[float]) -> None:
    image = torch.tensor(rgb).view(1, 3, 1, 1)
    for tone in ("srgb", "neutral", "aces"):
        for gamut in ("hue", "clip"):
            shown = Display(0.0, tone, gamut).picture(image)
            assert torch.isfinite(shown).all()
            assert shown.min() >= 0
            assert shown.max() <= 1


def test_neutral_keeps_base_colours_and_hue() -> None:
    """Khronos' specification: base colours up to 0.8 − F90's 0.04 are only less 0.04."""
    base = pixels([[0.2, 0.3, 0.5], [0.7, 0.1, 0.4]])
    assert torch.allclose(neutral(base), base - 0.04)
    dark = pixels([[0.05, 0.3, 0.5]])
    assert torch.allclose(neutral(dark), dark - (0.05 - 6.25 * 0.05**2))
    grey = pixels([[x] * 3 for x in np.geomspace(0.1, 1000, 50)])
    shown = neutral(grey)[0, 0, 0]
    assert (shown.diff() > 0).all()
    assert 0.99 < shown[-1] < 1


def test_aces_is_narkowicz_fit() -> None:
    shown = aces(pixels([[0.18 / 0.6, 1.0, 1e6]]))[0, :, 0, 0].tolist()
    x = np.array([0.18, 0.6])
    wanted = (x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14)
    assert shown == pytest.approx([*wanted, 1.0])


def test_key_exposure() -> None:
    image = torch.zeros(1, 3, 2, 4)
    image[..., :2] = torch.tensor([0.5, 8.0])  # their geometric mean is 2
    assert key_exposure_ev(image) == pytest.approx(np.log2(0.18 / 2))
    assert key_exposure_ev(torch.zeros(1, 3, 2, 2)) == 0
    assert Display("key").stops(image) == key_exposure_ev(image)


def test_bands_are_the_picture() -> None:
    image = torch.rand(2, 3, 1100, 257, generator=torch.Generator().manual_seed(0)) * 1.5 - 0.1
    whole = Display(0.5).picture(image)
    parts = [Display(0.5).picture(part) for part in image.split(410, -2)]
    assert torch.allclose(torch.cat(parts, -2), whole)
    assert torch.allclose(to_display(image), Display(0.0, gamut="clip").picture(image))


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_display_p3_is_read_back(tmp_path: Path, suffix: str) -> None:
    """By our reader (cICP), and by LittleCMS (the profile), within 8 bits and JPEG's losses."""
    light = torch.tensor([0.75, 0.02, 0.05]).view(1, 3, 1, 1).expand(1, 3, 16, 16)
    wide = light.clone()
    wide[:, 1] = -0.02  # outside sRGB, inside Display P3
    path = tmp_path / f"wide{suffix}"
    Display(0.0, colour_space="display-p3").write(wide, path)
    with pytest.warns(UserWarning, match="outside sRGB"):
        read = read_photograph(path).linear[0, :, 8, 8]
    assert torch.allclose(read, wide[0, :, 8, 8], atol=0.005 if suffix == ".png" else 0.02)
    with Image.open(path) as image:
        profile = ImageCms.ImageCmsProfile(io.BytesIO(image.info["icc_profile"]))
        assert ImageCms.getProfileDescription(profile).strip() == "Display P3"
        stored = np.asarray(image)[8, 8] / 255
        lab = ImageCms.createProfile("LAB")
        to_lab = ImageCms.buildTransform(profile, lab, "RGB", "LAB", 1)
        got = np.asarray(ImageCms.applyTransform(image, to_lab))[8, 8].astype(float)
    p3 = colour.RGB_COLOURSPACES["Display P3"]
    xyz = p3.matrix_RGB_to_XYZ @ colour.models.eotf_sRGB(stored)
    d50 = np.array([0.3457, 0.3585])
    xyz = colour.chromatic_adaptation(
        xyz,
        colour.xy_to_XYZ(p3.whitepoint),
        colour.xy_to_XYZ(d50),
        method="Von Kries",
        transform="Bradford",
    )
    wanted = colour.XYZ_to_Lab(xyz, d50)
    signed = [got[0] * 100 / 255, *((got[1:] + 128) % 256 - 128)]
    assert signed == pytest.approx(wanted, abs=1.2)


def test_png_names_its_space_before_its_pixels(tmp_path: Path) -> None:
    Display(0.0, colour_space="display-p3").write(torch.rand(1, 3, 8, 8), tmp_path / "p3.png")
    data = (tmp_path / "p3.png").read_bytes()
    assert data.index(b"cICP\x0c\x0d\x00\x01") < data.index(b"iCCP") < data.index(b"IDAT")
    Display(0.0).write(torch.rand(1, 3, 8, 8), tmp_path / "srgb.png")
    assert b"iCCP" not in (tmp_path / "srgb.png").read_bytes()


@pytest.mark.parametrize("space", ["display-p3", "acescg"])
def test_exr_in_wide_primaries_is_read_back(tmp_path: Path, space: str) -> None:
    light = torch.rand(1, 3, 4, 5) * 3 - 0.2
    path = tmp_path / "wide.exr"
    assert Display(1.0, colour_space=space).write(light, path) == 1.0
    stated = ExrFile(path).first.chromaticities
    wanted = colour.RGB_COLOURSPACES[SPACES[space]]
    assert stated == pytest.approx([*wanted.primaries.ravel(), *wanted.whitepoint], abs=1e-4)
    assert torch.allclose(read_photograph(path).linear, light * 2, atol=4e-3)


def test_wrong_displays_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected one of srgb, neutral, aces, got 'filmic'"):
        Display(tone="filmic")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="expected stops, auto or key, got 'bright'"):
        Display("bright")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="expected finite stops"):
        Display(float("nan"))
    with pytest.raises(InputError, match=r"expected an \.exr for ACEScg"):
        Display(colour_space="acescg").write(torch.rand(1, 3, 2, 2), tmp_path / "a.png")


def test_a_picture_of_an_image_with_gradients_is_the_same_picture() -> None:
    """As `shade` gives it of a model that has just been fitted."""
    light = torch.rand(1, 3, 6, 5)
    shown = Display(exposure=0.0).picture((2 * light).requires_grad_() * 1)
    assert not shown.requires_grad
    assert torch.equal(shown, Display(exposure=0.0).picture(2 * light))
