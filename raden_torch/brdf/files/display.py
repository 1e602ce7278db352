"""From scene-linear RGB to a picture: the display transform, which comes last, and the file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch
from torch import Tensor

from raden_torch.brdf.files.exr_tensors import write_image
from raden_torch.brdf.files.gamut import GAMUTS, Gamut, into_gamut
from raden_torch.brdf.files.tone import TONES, Tone, toned
from raden_torch.colorimetry import ACESCG, DISPLAY_P3, SRGB, SRGB_LUMINANCE, between
from raden_torch.errors import InputError
from raden_torch.files import check_writable
from raden_torch.images.pixels import draw_caption, write_pixels
from raden_torch.packages import require

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")

ColourSpace = Literal["srgb", "display-p3", "acescg"]
"""Of a file: a picture's primaries, always with sRGB's curve; or a linear EXR's. ACEScg is an
EXR's alone."""
PRIMARIES: dict[ColourSpace, tuple[float, ...]] = {
    "srgb": SRGB,
    "display-p3": DISPLAY_P3,
    "acescg": ACESCG,
}
_CHUNKED: dict[ColourSpace, str] = {"display-p3": "Display P3"}
"""Spaces of pictures that are named in the file; a picture that names none is sRGB."""

Exposure = float | Literal["auto", "key"]
"""Stops; "auto" and "key" as `auto_exposure_ev` and `key_exposure_ev` find them."""

_BAND = 1 << 18
"""Pixels that are transformed at a time: what is made on the way stays in the processor's cache."""
_STRAIGHT_TO = 0.0031308
"""sRGB's curve is a straight line up to here."""
_KEY = 0.18
_DARKEST = 1e-6
"""Of the brightest luminance: pixels below are background, not part of the key."""


@dataclass(frozen=True)
class Display:
    """How scene-linear light becomes a picture.

    Attributes:
        exposure: stops, or how they are chosen.
        tone: the curve from light to the display's light, see `tone.py`.
        gamut: what becomes of colours that the display cannot show, see `gamut.py`.
        colour_space: of the file.

    Examples:
        A red that is purer than sRGB's: at the edge of sRGB, and as it is in Display P3:

        >>> import torch
        >>> from raden_torch.brdf.files.display import Display
        >>> light = torch.tensor([0.6, -0.02, 0.02]).view(1, 3, 1, 1)
        >>> for space in ("srgb", "display-p3"):
        ...     shown = Display(exposure=0.0, colour_space=space).picture(light)
        ...     print([round(value, 2) for value in shown.flatten().tolist()])
        [0.76, 0.0, 0.19]
        [0.73, 0.01, 0.18]
    """

    exposure: Exposure = "auto"
    tone: Tone = "srgb"
    gamut: Gamut = "hue"
    colour_space: ColourSpace = "srgb"

    def __post_init__(self) -> None:
        for name, known in (
            ("tone", TONES),
            ("gamut", GAMUTS),
            ("colour_space", get_args(ColourSpace)),
        ):
            if getattr(self, name) not in known:
                raise InputError(
                    f"{name}: expected one of {', '.join(known)}, got {getattr(self, name)!r}"
                )
        if isinstance(self.exposure, str):
            if self.exposure not in ("auto", "key"):
                raise InputError(f"exposure: expected stops, auto or key, got {self.exposure!r}")
        elif not np.isfinite(self.exposure):
            raise InputError(f"exposure: expected finite stops, got {self.exposure}")

    def stops(self, image: Tensor) -> float:
        """The exposure of an image `[B, 3, H, W]`, in stops."""
        if self.exposure == "auto":
            return auto_exposure_ev(image)
        return key_exposure_ev(image) if self.exposure == "key" else float(self.exposure)

    def picture(self, image: Tensor) -> Tensor:
        """Scene-linear sRGB `[B, 3, H, W]` → the file's RGB in 0…1, sRGB's curve; no gradient."""
        image = image.detach()
        gain = 2.0 ** self.stops(image)
        shown = torch.empty_like(image, dtype=torch.float32)
        height = max(1, _BAND // max(image.shape[0] * image.shape[-1], 1))
        for band, rows in zip(shown.split(height, -2), image.split(height, -2), strict=True):
            band.copy_(self._shown(rows.float() * gain))
        return shown

    def _shown(self, light: Tensor) -> Tensor:
        light, primaries = self._in_space(light), PRIMARIES[self.colour_space]
        if self.gamut == "hue":
            light = into_gamut(light, primaries, top=1.0 if self.tone == "srgb" else None)
        else:
            light = light.clamp(min=0)
        return srgb_coded(toned(light, self.tone).clamp(0, 1))

    def curved(self, light: Tensor) -> Tensor:
        """Scene-linear sRGB by the tone curve alone, for what joins a picture that has its own."""
        if self.tone == "srgb":
            return light
        kept = into_gamut(light, top=None) if self.gamut == "hue" else light.clamp(min=0)
        return toned(kept, self.tone)

    def linear(self, image: Tensor) -> Tensor:
        """Scene-linear sRGB `[B, 3, H, W]` → an EXR's linear RGB, unclipped."""
        return self._in_space(image * 2.0**self.linear_stops if self.linear_stops else image)

    @property
    def linear_stops(self) -> float:
        """An EXR's: 0 unless stops were asked for."""
        return 0.0 if isinstance(self.exposure, str) else float(self.exposure)

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Of files that can say which colour space theirs is."""
        return (".exr",) if self.colour_space == "acescg" else (*PICTURE_SUFFIXES, ".exr")

    @property
    def profile(self) -> str | None:
        """A picture's; None where it goes unsaid, as sRGB's."""
        return _CHUNKED.get(self.colour_space)

    @property
    def chromaticities(self) -> tuple[float, ...] | None:
        """An EXR's attribute; None where it goes unsaid, as sRGB's."""
        return None if self.colour_space == "srgb" else PRIMARIES[self.colour_space]

    def _in_space(self, image: Tensor) -> Tensor:
        if self.colour_space == "srgb":
            return image
        matrix = image.new_tensor(between(SRGB, PRIMARIES[self.colour_space]))
        return torch.einsum("ij,...jhw->...ihw", matrix, image)

    def write(
        self, image: Tensor, path: str | os.PathLike[str], caption: str | None = None
    ) -> float:
        """Write a scene-linear image `[1, 3, H, W]`: a PNG or JPEG by `picture`, or an EXR, which
        stays linear and is exposed by stops alone.

        Args:
            caption: as for `write_picture`; an EXR has none.

        Returns:
            The exposure in stops; 0 for an EXR unless stops were asked for.

        Raises:
            InputError: a suffix of neither; a picture in ACEScg, which is linear; no such folder.
        """
        self.check_path(path)
        if Path(path).suffix.lower() == ".exr":
            write_image(self.linear(image), path, chromaticities=self.chromaticities)
            return self.linear_stops
        stops = self.stops(image)
        write_picture(self.picture(image)[0], path, caption, colour_space=self.colour_space)
        return stops

    def check_path(self, path: str | os.PathLike[str]) -> None:
        """Raise InputError where `write` would, so before the work is done."""
        check_picture_path(path, (*PICTURE_SUFFIXES, ".exr"))
        if Path(path).suffix.lower() not in self.suffixes:
            raise InputError(
                f"{path}: expected an .exr for ACEScg, which is linear; display-p3 is a picture's"
            )


AS_IT_IS = Display()
"""How a picture is shown unless one says otherwise."""


def to_display(image: Tensor, exposure_ev: float = 0.0) -> Tensor:
    """Scene-linear `[B, 3, H, W]` → sRGB in 0…1: exposure in stops, clipping, the sRGB curve.

    Out-of-gamut (negative) values are kept up to here and clipped here; `Display` keeps their hue.
    """
    return Display(exposure_ev, gamut="clip").picture(image)


def srgb_coded(linear: Tensor) -> Tensor:
    """Linear 0…1 → sRGB's code 0…1 (IEC 61966-2-1)."""
    # each part stands still where the other counts; exp2 and log2 take a third of a power's time
    curved = linear.clamp(min=_STRAIGHT_TO).log2_().mul_(1 / 2.4).exp2_().mul_(1.055)
    return curved.sub_(1.055 * _STRAIGHT_TO ** (1 / 2.4)).add_(
        linear.clamp(max=_STRAIGHT_TO), alpha=12.92
    )


def auto_exposure_ev(image: Tensor, white: float = 0.9, share: float = 0.995) -> float:
    """Stops that bring the `share` quantile of the lit pixels' largest channel to `white`."""
    brightest = image.detach().float().amax(dim=-3).flatten()
    lit = brightest[brightest > 0]
    if not len(lit):
        return 0.0
    level = float(np.quantile(lit.cpu().numpy(), share))
    return float(np.log2(white / level))


def key_exposure_ev(image: Tensor, key: float = _KEY) -> float:
    """Stops that bring the geometric mean of the lit pixels' luminance to `key`.

    Source: Reinhard et al., "Photographic Tone Reproduction for Digital Images" (2002), eq. (1);
    lit is what has a millionth of the brightest luminance, so a black background does not count.
    """
    weights = torch.tensor(SRGB_LUMINANCE, device=image.device)
    luminance = torch.einsum("c,...chw->...hw", weights, image.detach().float()).flatten()
    brightest = float(luminance.max()) if luminance.numel() else 0.0
    if not brightest > 0:
        return 0.0
    lit = luminance[luminance > _DARKEST * brightest]
    return float(np.log2(key) - lit.double().log2().mean())


def check_picture_path(
    path: str | os.PathLike[str], suffixes: tuple[str, ...] = PICTURE_SUFFIXES
) -> None:
    """Raise InputError where a picture could not be written, so before the work is done."""
    if set(PICTURE_SUFFIXES) <= set(suffixes):  # graphs are written by Matplotlib
        require("pictures", "images")
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        wanted = ", ".join(suffixes)
        raise InputError(f"{path}: suffix: expected one of {wanted}, got {path.suffix or '(none)'}")
    check_writable(path)


def write_picture(
    picture: Tensor,
    path: str | os.PathLike[str],
    caption: str | None = None,
    *,
    colour_space: ColourSpace = "srgb",
) -> None:
    """Write one display-referred `[3, H, W]` picture (0…1) as an 8-bit PNG or JPEG.

    Args:
        caption: a small line drawn into the lower left corner, as "simulated specimen".
        colour_space: of the picture's RGB, "srgb" or "display-p3"; named in the file.

    Raises:
        InputError: a suffix that is no picture's, or a folder that does not exist.
    """
    check_picture_path(path)
    rgb = eight_bits(picture, caption)
    write_pixels(rgb, path, profile=_CHUNKED.get(colour_space))


def eight_bits(picture: Tensor, caption: str | None = None) -> np.ndarray:
    """`[3, H, W]` in 0…1 → `[H, W, 3]` in 0…255, with a caption in the lower left corner."""
    rgb = (picture.detach().clamp(0, 1) * 255).round().to(torch.uint8).movedim(0, -1).cpu().numpy()
    if caption:
        rgb = np.ascontiguousarray(rgb)
        draw_caption(rgb, caption)
    return rgb
