"""Targa, PSD, DPX, SGI, JPEG 2000 and JPEG XL: formats of compositors, read by OpenImageIO; HEIC
by libheif."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.files import first_bytes
from raden_torch.images.header import Alpha, ColourTags, Header, check_size
from raden_torch.images.heif import NAME as HEIC
from raden_torch.images.heif import is_heic, read_heic
from raden_torch.images.openimageio import error_of, opened, openimageio

_STARTS = {
    b"8BPS": "PSD",
    b"SDPX": "DPX",
    b"XPDS": "DPX",
    b"\x01\xda": "SGI",
    b"\0\0\0\x0cjP  ": "JPEG 2000",
    b"\xff\x4f\xff\x51": "JPEG 2000",
    b"\0\0\0\x0cJXL ": "JPEG XL",
    b"\xff\x0a": "JPEG XL",
}
_TARGA_MAPS, _TARGA_KINDS = (0, 1), (1, 2, 3, 9, 10, 11)
_CHANNELS = (("Y",), ("Y", "A"), ("R", "G", "B"), ("R", "G", "B", "A"))
_TYPES = {"uint8": (8, "u"), "uint16": (16, "u"), "half": (32, "f"), "float": (32, "f")}
_STRAIGHT = ("JPEG 2000", "JPEG XL")
_DPX_CURVES = ("", "Undefined", "User defined", "Linear")
_AS_STORED = {"oiio:UnassociatedAlpha": 1, "oiio:RawColor": 1}


def other_format(path: str | os.PathLike[str], start: bytes | None = None) -> str | None:
    """The name of one of these formats; None for any other file, or none.

    Args:
        start: the first bytes, where they are known. Those of Targa say little: its suffix counts,
            too.

    Raises:
        InputError: a pipe or a device.
    """
    start = first_bytes(path, 64) if start is None else start
    if start is None:
        return None
    if is_heic(start):
        return HEIC
    found = next((name for first, name in _STARTS.items() if start.startswith(first)), None)
    if found is None and Path(path).suffix.lower() == ".tga":
        is_targa = len(start) > 2 and start[1] in _TARGA_MAPS and start[2] in _TARGA_KINDS
        return "Targa" if is_targa else None
    return found


def read_other(path: str | os.PathLike[str], name: str) -> tuple[Header, NDArray[Any]]:
    """What the file says of itself, and `[H, W, C]` as stored: grey or RGB, with alpha or without.

    Half floats come as 32-bit ones, DPX of 10 or 12 bits as 16. Of a PSD this is the flattened
    image.

    Args:
        name: of the format, as of `other_format`.

    Raises:
        InputError: damaged; too large; neither grey nor RGB; of other numbers than 8 or 16 bits or
            floats; a DPX in logarithmic or video code; several frames.
    """
    if name == HEIC:
        return read_heic(path)

    def damaged(reason: str) -> InputError:
        return InputError(f"{path}: a damaged {name} file; expected a whole one ({reason})")

    oiio = openimageio()
    with opened(path, damaged, _AS_STORED) as file:
        spec = file.spec()
        check_size(path, spec.width, spec.height)
        header = _header(path, name, spec)
        if name != "PSD" and file.seek_subimage(1, 0):
            raise InputError(f"{path}: expected one image, got several; save the one that is meant")
        kind = oiio.FLOAT if header.kind == "f" else spec.format
        values = file.read_image(0, 0, 0, spec.nchannels, kind)
        if values is None:
            raise damaged(error_of(file))
    return header, values if values.shape[2] > 1 else values[..., 0]


def _header(path: str | os.PathLike[str], name: str, spec: Any) -> Header:
    channels = tuple(spec.channelnames)
    if channels not in _CHANNELS or spec.depth != 1:
        raise InputError(
            f"{path}: expected grey or RGB, got the channels {', '.join(channels)}; convert it to "
            "sRGB first"
        )
    if spec.channelformats or str(spec.format) not in _TYPES:
        raise InputError(f"{path}: expected 8 or 16 bits or floats, got {spec.format}")
    transfer = spec.get_string_attribute("dpx:Transfer")
    if transfer not in _DPX_CURVES:
        raise InputError(
            f"{path}: expected a DPX in linear light, or without a curve, got {transfer}; convert "
            "it first"
        )
    alpha: Alpha = "none"
    if channels[-1] == "A":
        # OpenImageIO says it of Targa and PSD; DPX and SGI hold what a compositor multiplied
        told = spec.get_int_attribute("oiio:UnassociatedAlpha", 0)
        alpha = "straight" if told or name in _STRAIGHT else "associated"
    bits, letter = _TYPES[str(spec.format)]
    profile = spec.getattribute("ICCProfile")
    turned = spec.get_int_attribute("Orientation", 1)
    return Header(
        name,
        bits,
        letter,
        alpha,
        turned if 1 <= turned <= 8 else 1,
        colour=ColourTags(
            icc=None if profile is None else np.asarray(profile, np.uint8).tobytes(),
            gamma=1.0 if transfer == "Linear" else None,
        ),
    )
