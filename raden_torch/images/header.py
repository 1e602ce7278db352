"""An image file's header, read before its pixels; unsupported files are refused here."""

from __future__ import annotations

import os
import re
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from raden_torch.errors import InputError
from raden_torch.files import check_seekable
from raden_torch.images.shot_settings import orientation_of
from raden_torch.packages import require

MAX_PIXELS = 178_956_970
"""Pillow's own limit against decompression bombs."""

Alpha = Literal["none", "straight", "associated"]

_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "GIF", "WEBP", "PPM")
_KNOWN = (
    "a PNG, JPEG, TIFF, BMP, GIF, WebP, PPM, Radiance HDR, Targa, PSD, DPX, SGI, JPEG 2000, JPEG "
    "XL or HEIC image"
)
_GREY_OR_RGB = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX", "YCbCr", "I;16", "I", "F")
_PHOTOMETRIC = {5: "CMYK", 8: "Lab", 9: "Lab", 10: "Lab", 32803: "CFA", 34892: "LinearRaw"}
_TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


@dataclass(frozen=True)
class ColourTags:
    """A file's colour tags; `colour_space.py` interprets them.

    Attributes:
        icc: an ICC profile.
        cicp: PNG's cICP, or HEIC's nclx in its terms: primaries, transfer, matrix, full range.
        srgb: PNG's sRGB chunk is there.
        gamma: PNG's gAMA, 1/2.2 for a display's curve.
        chromaticities: x, y of red, green, blue and white.
        adobe: EXIF says Adobe RGB (its interoperability index is R03).
    """

    icc: bytes | None = None
    cicp: tuple[int, int, int, int] | None = None
    srgb: bool = False
    gamma: float | None = None
    chromaticities: tuple[float, ...] | None = None
    adobe: bool = False


@dataclass(frozen=True)
class Header:
    """One image's header.

    Attributes:
        format: Pillow's name of it, "HDR", or that of `other_format`.
        bits: of one stored value; 8 where there are fewer.
        kind: NumPy's letter for the stored values: u, i or f.
        alpha: whether the colours are multiplied by it.
        orientation: EXIF's, 1…8.
        zero_is_white: a grey TIFF that counts down.
        tags: TIFF tags, EXIF included.
    """

    format: str
    bits: int
    kind: str = "u"
    alpha: Alpha = "none"
    orientation: int = 1
    zero_is_white: bool = False
    colour: ColourTags = field(default_factory=ColourTags)
    tags: Mapping[int, Any] = field(default_factory=dict)


def read_header(path: str | os.PathLike[str]) -> Header:
    """The header of a PNG, JPEG, TIFF, BMP, GIF, WebP, PPM or Radiance HDR file.

    Of a JPEG with more pictures in it (MPO), the main one counts; of a TIFF, small previews do not.

    Raises:
        InputError: missing; not one of these; several images; more than `MAX_PIXELS` pixels; not
            grey or RGB (CMYK, Lab, …); or values of a type that the decoders spoil.
    """
    try:
        check_seekable(path)
        with open(path, "rb") as file:
            start = file.read(65536)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; expected {_KNOWN}") from None
    require("images", "images")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # damaged EXIF, large images
        if start[:4] in _TIFF_STARTS:
            try:
                return _tiff(path, start)
            except (ValueError, TypeError, IndexError) as error:  # numbers that are texts
                if isinstance(error, InputError):
                    raise
                raise _damaged_tiff(path) from None
        if start.startswith(b"#?"):
            return _radiance(path, start)
        return _by_pillow(path, start)


def _by_pillow(path: str | os.PathLike[str], start: bytes) -> Header:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path, formats=_FORMATS) as image:
            check_size(path, *image.size)
            if image.format != "MPO":
                _check_frames(path, getattr(image, "n_frames", 1))
            mode, info, name = image.mode, image.info, str(image.format)
            exif = image.getexif()
            index = exif.get_ifd(0xA005).get(1)
            tags = dict(exif) | dict(exif.get_ifd(0x8769))
            depth = _ppm_levels(image) if name == "PPM" else 255
    except Image.DecompressionBombError:
        raise InputError(f"{path}: expected at most {MAX_PIXELS} pixels, got more") from None
    except (
        MemoryError,
        UnidentifiedImageError,
        OSError,
        SyntaxError,
        ValueError,
        struct.error,
    ) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path}: not an image that is read here (it starts with {start[:8]!r}), or damaged; "
            f"expected {_KNOWN}"
        ) from None
    if mode not in _GREY_OR_RGB:
        raise _not_rgb(path, mode)
    is_deep = (name == "PNG" and start[24] == 16) or depth > 255
    if depth > 255 and depth != 65535:
        raise InputError(f"{path}: expected levels up to 255 or 65535, got {depth}")
    if is_deep and mode == "I;16" and "transparency" in info:
        raise InputError(f"{path}: expected an alpha channel, got one transparent grey in 16 bits")
    has_alpha = mode in ("RGBA", "LA", "PA") or "transparency" in info
    return Header(
        name,
        32 if mode == "F" else 16 if is_deep else 8,
        "f" if mode == "F" else "u",
        "straight" if has_alpha else "none",
        orientation_of(tags) or 1,
        colour=_colour_tags(path, info, is_adobe=index in ("R03", b"R03", b"R03\0")),
        tags=tags,
    )


def _ppm_levels(image: Any) -> int:
    """The largest value, as Pillow tells its decoder; smaller ones than 255 are scaled to it."""
    args = image.tile[0][3]
    levels = 65535 if image.mode == "I" else 255
    return int(args[1]) if isinstance(args, tuple) and isinstance(args[1], int) else levels


def _colour_tags(
    path: str | os.PathLike[str], info: Mapping[str, Any], *, is_adobe: bool
) -> ColourTags:
    place = info.get("chromaticity")  # PNG puts white first
    return ColourTags(
        info.get("icc_profile") or None,
        _cicp(path),
        "srgb" in info,
        info.get("gamma"),
        None if place is None else (*place[2:], *place[:2]),
        is_adobe,
    )


def _cicp(path: str | os.PathLike[str]) -> tuple[int, int, int, int] | None:
    """PNG's cICP chunk, which Pillow leaves out."""
    with open(path, "rb") as file:
        if file.read(8) != b"\x89PNG\r\n\x1a\n":
            return None
        while len(head := file.read(8)) == 8 and head[4:] != b"IDAT":
            length = int.from_bytes(head[:4], "big")
            if head[4:] == b"cICP" and length == 4:
                a, b, c, d = file.read(4)
                return a, b, c, d
            file.seek(length + 4, os.SEEK_CUR)
    return None


def _tiff(path: str | os.PathLike[str], start: bytes) -> Header:
    directories = _directories(path, start)
    whole = [tags for tags in directories if not tags.get(254, 0) & 1]  # the rest are previews
    _check_frames(path, len(whole))
    if whole[0] is not directories[0]:
        raise InputError(f"{path}: expected an image at its start, got a preview (a raw file?)")
    tags = whole[0]
    check_size(path, int(tags.get(256, 0)), int(tags.get(257, 0)))
    photometric = tags.get(262, 1)
    if photometric not in (0, 1, 2, 3, 6):
        raise _not_rgb(path, _PHOTOMETRIC.get(photometric, f"photometric {photometric}"))
    samples, extra = int(tags.get(277, 1)), tuple(tags.get(338, ()))
    colours = 1 if photometric in (0, 1, 3) else 3
    kinds = {1: "u", 2: "i", 3: "f", 4: "u"}
    kind = kinds.get(_first(tags.get(339, 1)), "?")
    bits = max(8, int(_first(tags.get(258, 1))))
    there = samples - colours
    if there > 1 or (there == 1 and colours == 1 and bits > 8):
        raise InputError(
            f"{path}: {samples} channels of {bits} bits in a TIFF; expected grey, RGB or RGBA"
        )
    if bits > 8 and samples > 1 and tags.get(284) == 2:
        raise InputError(
            f"{path}: expected the colours of a pixel side by side, got planes of {bits} bits; "
            "write it with interleaved channels"
        )
    is_known = f"{kind}{bits}" in ("u8", "u16", "i16", "u32", "i32", "f32", "f64")
    if not is_known or (photometric == 0 and kind != "u"):
        what = {"u": "unsigned", "i": "signed", "f": "float"}.get(kind, "unknown")
        raise InputError(f"{path}: expected 8 or 16 bits or 32-bit floats, got {what} {bits} bits")
    meaning, profile = _first(extra) if extra else 2, tags.get(34675)
    alpha: Alpha = "none"
    if there == 1:
        alpha = "associated" if meaning == 1 else "straight" if meaning == 2 else "none"
    return Header(
        "TIFF",
        bits,
        kind,
        alpha,
        orientation_of(tags) or 1,
        photometric == 0,
        ColourTags(icc=profile if isinstance(profile, bytes) and profile else None),
        tags,
    )


def _directories(path: str | os.PathLike[str], start: bytes) -> list[dict[int, Any]]:
    """The tags of each image in a TIFF; Pillow's own reader knows fewer kinds of pixels."""
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    found: list[dict[int, Any]] = []
    is_big = start[2:4] in (b"+\0", b"\0+")
    try:
        directory = ImageFileDirectory_v2(start[: 16 if is_big else 8])
        with open(path, "rb") as file:
            seen = {0}
            while (place := directory.next) not in seen:
                seen.add(place)
                file.seek(place)
                directory.load(file)
                found.append(dict(directory))
            if place:  # a ring, or cut off
                raise ValueError
            if found and 34665 in found[0]:
                inner = ImageFileDirectory_v2(start[: 16 if is_big else 8])
                file.seek(found[0][34665])
                inner.load(file)
                found[0] = dict(inner) | found[0]
    except (OSError, SyntaxError, ValueError, TypeError, KeyError, struct.error):
        found = []
    if not found:
        raise _damaged_tiff(path)
    return found


def _damaged_tiff(path: str | os.PathLike[str]) -> InputError:
    return InputError(f"{path}: a damaged TIFF; expected a whole one")


def _radiance(path: str | os.PathLike[str], start: bytes) -> Header:
    text = start.decode("latin-1")
    size = re.search(r"\n\n-Y (\d+) \+X (\d+)\n", text)
    if size is None:
        raise InputError(f"{path}: expected a Radiance HDR image with rows from the top (-Y, +X)")
    check_size(path, int(size[2]), int(size[1]))
    lines = dict(re.findall(r"^(\w+)=(.*)$", text[: size.start()], re.M))
    if "xyze" in lines.get("FORMAT", ""):
        raise _not_rgb(path, "XYZ")
    try:
        place = tuple(float(word) for word in lines.get("PRIMARIES", "").split())
    except ValueError:
        place = ()
    colour = ColourTags(gamma=1.0, chromaticities=place if len(place) == 8 else None)
    return Header("HDR", 32, "f", colour=colour)


def _first(value: Any) -> int:
    return int(value[0] if isinstance(value, tuple) else value)


def _check_frames(path: str | os.PathLike[str], frames: int) -> None:
    if frames != 1:
        raise InputError(
            f"{path}: expected one image, got {frames} frames; save the one that is meant"
        )


def _not_rgb(path: str | os.PathLike[str], got: str) -> InputError:
    return InputError(f"{path}: expected grey or RGB, got {got}; convert it to sRGB first")


def check_size(path: str | os.PathLike[str], width: int, height: int) -> None:
    """Raise InputError where there are no pixels, or too many."""
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise InputError(
            f"{path}: {width} x {height} pixels; expected 1…{MAX_PIXELS} pixels in all"
        )
