"""OpenEXR files and images in words."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from raden_torch.errors import InputError
from raden_torch.images.header import read_header
from raden_torch.images.heif import NAME as HEIC
from raden_torch.images.heif import said_of_heic
from raden_torch.images.other_formats import other_format
from raden_torch.images.pixels import read_image
from raden_torch.images.raw import begins_as_raw, is_raw, read_raw
from raden_torch.images.shot_settings import settings_in_words, settings_of
from raden_torch.packages import require

if TYPE_CHECKING:
    from raden_torch.images.exr_file import ExrFile

_MOST_LAYERS = 40
_CHANNELS = {1: "grey", 2: "grey, alpha", 3: "RGB", 4: "RGB, alpha"}
_IMAGES = re.compile(
    rb"\x89PNG\r\n\x1a\n|\xff\xd8\xff|II[*+]\0|MM\0[*+]|#\?(?:RADIANCE|RGBE)|GIF8|RIFF.{4}WEBP"
    rb"|BM.{4}\0{4}|P[1-6]\s",
    re.DOTALL,
)
"""How PNG, JPEG, TIFF, Radiance, GIF, WebP, BMP and PPM files begin."""


def recognises_exr(head: bytes) -> bool:
    return head.startswith(b"\x76\x2f\x31\x01")


def describe_exr(path: Path) -> str:
    """Size, layers, compression, and what of a G-buffer is in it."""
    from raden_torch.images.exr_file import ExrFile

    file = ExrFile(path)
    file.check_whole()
    height, width = file.size
    lines = [f"OpenEXR file: {width} x {height} pixels (width x height)"]
    for name, part in file.parts.items():
        stored = f"tiles of {part.tile[0]} x {part.tile[1]}" if part.tile else "scan lines"
        of = f"part {name}: " if name else ""
        lines.append(f"{of}{stored}, compression {part.compression.upper()}")
        if part.data != part.display:
            lines.append(f"data window {part.data}; display window {part.display}")
        lines += _layers(part.channels)
    return "\n".join([*lines, _gbuffer(file)])


def _layers(channels: Mapping[str, str]) -> list[str]:
    """One line a layer and type: `layer N: X, Y, Z (float)`."""
    layers: dict[tuple[str, str], list[str]] = {}
    for name, kind in channels.items():
        layer, _, last = name.rpartition(".")
        layers.setdefault((layer, kind), []).append(last)
    lines = [
        f"{f'layer {layer}:' if layer else 'channels'} {', '.join(names)} ({kind})"
        for (layer, kind), names in layers.items()
    ]
    more = len(lines) - _MOST_LAYERS
    return lines if more <= 0 else [*lines[:_MOST_LAYERS], f"and {more} more layers"]


def _gbuffer(file: ExrFile) -> str:
    """Whether `raden render --gbuffer` finds what it needs."""
    from raden_torch.brdf.files.exr_tensors import evidence
    from raden_torch.images.exr_layers import Layers

    try:
        layers = Layers.of(file, None)
        normal, bare = layers.vector("normal"), layers.bare_vector()
        rows = min(file.size[0], file.most_rows)
        if normal is None and bare is not None and evidence(file, bare, [(0, rows)]).is_normals:
            normal = bare
        found = {"normals": normal, "depth": layers.scalar("depth"), "mask": layers.scalar("mask")}
        found["positions"] = layers.vector("position")
    except InputError as error:
        return f"no G-buffer as it is: {str(error).removeprefix(f'{file.path}: ')}"
    words = [
        f"{what} in {', '.join(channel for _, channel in keys)}"
        for what, keys in found.items()
        if keys is not None
    ]
    if found["normals"] is not None:
        return f"usable as a G-buffer: {'; '.join(words)}"
    if found["depth"] is not None:
        return f"usable as a G-buffer with --fov, normals made of depth: {'; '.join(words)}"
    return "no G-buffer as it is: no normals and no depth by the names that are known"


def recognises_image(head: bytes) -> bool:
    return (
        _IMAGES.match(head) is not None or other_format("", head) is not None or begins_as_raw(head)
    )


def describe_image(path: Path) -> str:
    """Size, channels, bits, and what the file says of itself; why it is not read, if it is not."""
    if is_raw(path):
        return _describe_raw(path)
    other = other_format(path)
    said = {} if other == HEIC else _said(path)  # which Pillow does not know
    width, height = said.pop("size", (0, 0))
    mode, form = said.pop("mode", ""), other or said.pop("format", "Radiance HDR")
    said.pop("format", None)
    more: list[str] = []
    try:
        if other is None:
            read_header(path)
    except InputError as error:
        if not mode:
            raise
        held = f"{mode}; cannot be read here: {str(error).removeprefix(f'{path}: ')}"
    else:
        image = read_image(path)
        height, width = image.pixels.shape[:2]
        channels = (1 if image.pixels.ndim == 2 else 3) + (image.alpha is not None)
        kind = "floating point" if image.pixels.dtype.kind == "f" else "whole numbers"
        held = f"{_CHANNELS[channels]}; {8 * image.pixels.dtype.itemsize} bits a channel, {kind}"
        more = settings_in_words(settings_of(image.header.tags))
        if other == HEIC:
            profile = image.header.colour.icc
            said["ICC profile"] = "none" if profile is None else _icc_name(profile)
            more += said_of_heic(path)
    lines = [f"{form} image: {width} x {height} pixels (width x height)", held]
    return "\n".join([*lines, *(f"{name}: {value}" for name, value in said.items()), *more])


def _describe_raw(path: Path) -> str:
    raw = read_raw(path)
    height, width = raw.values.shape[:2]
    black = ", ".join(f"{level:g}" for level in dict.fromkeys(raw.black.ravel().tolist()))
    if raw.pattern is not None:
        held = f"Bayer mosaic {raw.pattern}"
    else:
        held = "grey" if raw.is_grey else "linear colours"
    lines = [
        f"camera raw file: {width} x {height} pixels (width x height)",
        f"{held}; black level {black}, white level {raw.white:g}",
        *settings_in_words(settings_of(raw.tags, is_raw=True)),
    ]
    if raw.colour is not None:
        balance = ", ".join(f"{share:.3f}" for share in raw.colour.balance)
        lines.append(f"colours: {raw.colour.source} ({balance})")
    elif not raw.is_grey:
        lines.append("colours: an unknown camera; `raden capture colour` measures them")
    return "\n".join([*lines, *raw.notes])


def _said(path: Path) -> dict[str, Any]:
    """Format, frames, ICC profile and exposure, as far as Pillow knows the file."""
    require("images", "images")
    from PIL import Image, UnidentifiedImageError

    said: dict[str, Any] = {}
    try:
        with warnings.catch_warnings(), Image.open(path) as image:
            warnings.simplefilter("ignore")  # damaged tags: the pixels were read
            said["format"], said["size"], said["mode"] = image.format, image.size, image.mode
            said["frames"] = getattr(image, "n_frames", 1)
            icc = image.info.get("icc_profile")
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        return said
    said["ICC profile"] = _icc_name(icc) if icc else "none"
    return said


def _icc_name(profile: bytes) -> str:
    from PIL import ImageCms

    try:
        opened = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        return " ".join(ImageCms.getProfileDescription(opened).split())
    except (ImageCms.PyCMSError, OSError):
        return f"{len(profile)} bytes that are no profile"
