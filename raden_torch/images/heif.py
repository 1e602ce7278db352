"""HEIC pictures, as phones take them, by libheif (pillow-heif)."""

from __future__ import annotations

import os
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.images.header import Alpha, ColourTags, Header, check_size
from raden_torch.packages import quiet_stderr, require

NAME = "HEIC"
_BRANDS = (b"heic", b"heix", b"heim", b"heis")
_UNKNOWN = 2
"""Of primaries and of curves, in ITU-T H.273."""
_GAIN_MAP = "gainmap"


def is_heic(start: bytes) -> bool:
    """Whether a file begins as one: by its brand, or among those that it is compatible with."""
    if start[4:8] != b"ftyp":
        return False
    brands = start[8 : min(int.from_bytes(start[:4], "big"), len(start))]
    return any(brand in brands for brand in _BRANDS) and brands[:4] not in (b"avif", b"crx ")


def read_heic(path: str | os.PathLike[str]) -> tuple[Header, NDArray[Any]]:
    """What the file says of itself, and `[H, W]` or `[H, W, C]` of its main picture: 8 bits as they
    are, more of them scaled to 16.

    It is turned as the file's own transformations say; EXIF's orientation repeats them.

    Raises:
        InputError: damaged; too large, found before its memory is taken.
    """
    require("HEIC pictures", "heif")
    import pillow_heif

    try:
        with open(path, "rb") as file:
            with quiet_stderr():
                image = pillow_heif.open_heif(file, convert_hdr_to_8bit=False)
            check_size(path, *image.size)
            bits = int(image.info.get("bit_depth", 8))
            header = _header(image, bits)
            with quiet_stderr():
                values = np.array(image)
    except (
        *(OSError, ValueError, RuntimeError, EOFError, SyntaxError, MemoryError),
        *(IndexError, KeyError, TypeError),
    ) as error:
        if isinstance(error, InputError):
            raise
        reason = " ".join(str(error).split())
        raise InputError(
            f"{path}: a damaged {NAME} file; expected a whole one ({reason})"
        ) from None
    if 8 < bits < 16:  # libheif shifts them to the top
        most = (1 << bits) - 1
        whole = (values >> (16 - bits)).astype(np.uint32)
        values = ((whole * 65535 + most // 2) // most).astype(np.uint16)
    return header, values


def said_of_heic(path: str | os.PathLike[str]) -> list[str]:
    """What a person should know beside size and bits: pictures, and parts that are not used."""
    require("HEIC pictures", "heif")
    import pillow_heif

    with open(path, "rb") as file:
        with quiet_stderr():
            image = pillow_heif.open_heif(file)
        lines = [f"pictures: {len(image)}, the main one is read"] if len(image) > 1 else []
        if any(_GAIN_MAP in name for name in image.info.get("aux", {})):
            lines.append("HDR gain map: there, not used")
        return lines


def _header(image: Any, bits: int) -> Header:
    from PIL import Image

    tags: dict[int, Any] = {}
    data = image.info.get("exif")
    if data:
        exif = Image.Exif()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # damaged tags
                exif.load(data)
                tags = dict(exif) | dict(exif.get_ifd(0x8769))
        except (OSError, SyntaxError, ValueError, KeyError, TypeError, IndexError):
            tags = {}
    profile = image.info.get("icc_profile") or None
    coded = image.info.get("nclx_profile") or {}
    primaries = int(coded.get("color_primaries", _UNKNOWN))
    curve = int(coded.get("transfer_characteristics", _UNKNOWN))
    cicp = None
    if profile is None and (primaries, curve) != (_UNKNOWN, _UNKNOWN):
        cicp = (primaries, curve, 0, 1)  # RGB of the full range, once it is decoded
    alpha: Alpha = "associated" if image.premultiplied_alpha else "straight"
    return Header(
        NAME,
        8 if bits <= 8 else 16,
        alpha=alpha if image.has_alpha else "none",
        colour=ColourTags(icc=profile, cicp=cicp),
        tags=tags,
    )
