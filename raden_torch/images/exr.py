"""OpenEXR files as named channels: reading and writing, single- and multi-part.

Pixels come as float32, `[H, W]` of the *display* window: where the data window is smaller, the rest
is 0; what lies outside the display window is cut off. So all parts of a file have one size. Whole
numbers above 2²⁴ (object ids) lose their last digits. Of a tiled file the largest level is read.
"""

from __future__ import annotations

import os
import sys
import threading
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raden_torch.errors import InputError
from raden_torch.files import check_output, check_seekable, written_beside
from raden_torch.packages import require

MAX_PIXELS = 2**26
"""The largest window that is read or written at once, in pixels (8192 x 8192)."""
MAX_VALUES = 2**29
"""The most values that are read at once, pixels times channels (2 GiB as float32)."""
MAX_SIDE = 2**20
"""The most rows or columns of a file that is read or written by rows."""
_LARGE, _SPARSE = 1 << 24, 4096  # a larger display window may not be emptier than this

Parts = dict[str, dict[str, NDArray[np.float32]]]

_ONE_AT_A_TIME = threading.Lock()
"""Held while the process's outputs are caught."""
_MAGIC = b"\x76\x2f\x31\x01"
_MULTI_PART = 0x10  # in the second byte of the version field


def read_channels(path: str | os.PathLike[str]) -> dict[str, NDArray[np.float32]]:
    """Every channel of every part, `[H, W]`, by the names that `list_channels` gives.

    Raises:
        InputError: as for `read_parts`.
    """
    parts = read_parts(path)
    return {key: parts[part][name] for key, part, name in channel_keys(parts)}


def list_channels(path: str | os.PathLike[str]) -> list[str]:
    """The names of the channels, from the header alone.

    A name is as in the file. In a multi-part file, "part.name" for each channel of a part that
    shares a name with another part.

    Raises:
        InputError: as for `read_parts`, the pixels aside.
    """
    header = {name: _channel_names(header) for name, header in headers_of(path).items()}
    return [key for key, _, _ in channel_keys(header)]


def read_parts(path: str | os.PathLike[str]) -> Parts:
    """`{part: {channel: [H, W]}}`; the part of a single-part file may be called "".

    Raises:
        InputError: not an OpenEXR file, truncated or damaged; deep or subsampled; more pixels than
            `MAX_PIXELS` or more values than `MAX_VALUES` (found before the memory is taken).
    """
    expected = headers_of(path)
    file, said = _open(path, header_only=False)
    if len(file.parts) != len(expected):
        reason = said.splitlines()[0].rpartition(" - ")[2] if said else "pixels are missing"
        raise InputError(
            f"{path}: expected a whole OpenEXR file, got a truncated or damaged one ({reason})"
        )
    return {
        name: {c: placed(channel.pixels, part.header) for c, channel in part.channels.items()}
        for name, part in zip(expected, file.parts, strict=True)
    }


def channel_keys(parts: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, str, str]]:
    """(key, part, channel) of all channels: the key as `list_channels` describes it."""
    owners = Counter(channel for channels in parts.values() for channel in channels)
    keys = []
    for part, channels in parts.items():
        shared = any(owners[channel] > 1 for channel in channels)
        keys += [(f"{part}.{c}" if shared else c, part, c) for c in channels]
    return keys


def write_channels(
    path: str | os.PathLike[str], channels: Mapping[str, ArrayLike], *, half: bool = False
) -> None:
    """Write a single-part file.

    Args:
        channels: `{name: [H, W]}`, all of one size.
        half: 16-bit floats (11 bits of precision; infinite beyond 65504) instead of 32-bit ones.

    Raises:
        InputError: arrays that are not `[H, W]` or differ in size, a name that OpenEXR cannot hold,
            a suffix other than .exr, a folder that does not exist.
    """
    write_parts(path, {"": channels}, half=half)


def write_parts(
    path: str | os.PathLike[str],
    parts: Mapping[str, Mapping[str, ArrayLike]],
    *,
    half: bool = False,
) -> None:
    """Write `{part: {channel: [H, W]}}`, each a part with its name; all of one size.

    Raises:
        InputError: as for `write_channels`, or several parts of which one has no name.
    """
    if not parts or (len(parts) > 1 and "" in parts):
        raise InputError(
            f"{path}: parts: expected at least one, each with a name, got {list(parts)}"
        )
    arrays = {
        part: {name: _array(path, name, a, half) for name, a in channels.items()}
        for part, channels in parts.items()
    }
    _check_sizes(path, arrays)
    with written_beside(check_output(path, (".exr",))) as temporary:
        write_arrays(temporary, arrays, {}, path)


def write_arrays(
    path: str | os.PathLike[str],
    parts: Mapping[str, Mapping[str, NDArray[Any]]],
    header: Mapping[str, Any],
    meant: object,
) -> None:
    """Write checked arrays as they are, ZIP-compressed, with these additions to the header.

    Args:
        meant: the file that messages name.
    """
    require("OpenEXR files", "images")
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    try:
        with _captured():
            made = [OpenEXR.Part(dict(header), dict(a), part) for part, a in parts.items()]
            OpenEXR.File(made).write(os.fsencode(path))
    except (RuntimeError, ValueError, TypeError) as error:
        reason = " ".join(str(error).replace(str(path), str(meant)).split())
        raise InputError(f"{meant}: OpenEXR cannot write it: {reason}") from None


def headers_of(path: str | os.PathLike[str], *, by_rows: bool = False) -> dict[str, dict[str, Any]]:
    """The header of each part by its name, checked.

    Args:
        by_rows: the file is not read at once; its sides may be `MAX_SIDE`.

    Raises:
        InputError: as for `read_parts`, the pixels aside.
    """
    _check_magic(path)
    file, _ = _open(path, header_only=True)
    headers: dict[str, dict[str, Any]] = {}
    values = 0
    for part in file.parts:
        try:
            name = part.name()
            if name in headers:
                raise InputError(
                    f"{path}: expected a different name for each part, got {name!r} twice"
                )
            where = f"{path}: part {name!r}" if name else f"{path}"
            values += _check_header(where, part.header, by_rows)
        except UnicodeDecodeError:
            raise InputError(
                f"{path}: expected names of channels and parts in UTF-8, got other bytes: is it "
                "damaged?"
            ) from None
        headers[name] = part.header
    if values > MAX_VALUES and not by_rows:
        raise InputError(
            f"{path}: expected at most {MAX_VALUES} values in all channels, got {values}: write "
            "the channels that are needed to a file of their own"
        )
    if not headers:
        raise InputError(f"{path}: expected an OpenEXR file with pixels, got no part")
    return headers


def _check_magic(path: str | os.PathLike[str]) -> None:
    try:
        check_seekable(path)
        with open(path, "rb") as file:
            start = file.read(4)
    except OSError as error:
        raise InputError(
            f"{path}: expected an OpenEXR file, got an error: {error.strerror}"
        ) from None
    if start != _MAGIC:
        raise InputError(f"{path}: expected an OpenEXR file, got one that starts with {start!r}")


def _open(path: str | os.PathLike[str], *, header_only: bool) -> tuple[Any, str]:
    """OpenEXR's file, and what its Python side printed of pixels that it could not read."""
    require("OpenEXR files", "images")
    import OpenEXR

    try:
        with _captured() as said:
            # the name's own bytes: as text it would have to be UTF-8
            name = os.fsencode(path)
            file = OpenEXR.File(name, separate_channels=True, header_only=header_only)
    except MemoryError:
        raise
    except Exception:  # the binding lets through whatever C++ throws
        with open(path, "rb") as opened:
            version = opened.read(8)
        wanted = "a whole OpenEXR file"
        if len(version) == 8 and version[5] & _MULTI_PART:
            wanted += ", its parts with different names and the same display window"
        raise InputError(
            f"{path}: expected {wanted}, got a truncated or damaged one, which OpenEXR cannot open"
        ) from None
    return file, said.getvalue()


@contextmanager
def _captured() -> Iterator[StringIO]:
    """Catch what OpenEXR prints: C++ writes to the process's stderr, the binding to stdout."""
    said = StringIO()
    with _ONE_AT_A_TIME, redirect_stdout(said), _without_stderr():
        yield said


@contextmanager
def _without_stderr() -> Iterator[None]:
    if sys.stderr is not None:
        sys.stderr.flush()
    try:
        saved = os.dup(2)
    except OSError:  # the process was started without one
        yield
        return
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(sink)


def _check_header(where: str, header: Mapping[str, Any], by_rows: bool) -> int:
    """The number of values in this part's channels."""
    import OpenEXR

    names = _channel_names(header)
    if header.get("type") in (OpenEXR.deepscanline, OpenEXR.deeptile):
        raise InputError(f"{where}: expected one value a pixel, got deep pixels; flatten them")
    for channel in header["channels"]:
        if (channel.xSampling, channel.ySampling) != (1, 1):
            raise InputError(
                f"{where}: channel {channel.name!r}: expected one value a pixel (RGB), got it "
                f"subsampled {channel.xSampling} x {channel.ySampling}"
            )
    tile = header.get("tiles")
    if tile is not None and not 0 < tile.xSize * tile.ySize <= MAX_PIXELS:
        raise InputError(
            f"{where}: tiles: expected 1…{MAX_PIXELS} pixels, got {tile.xSize} x {tile.ySize}"
        )
    for window in ("dataWindow", "displayWindow"):
        height, width = _size(header[window])
        claims = f"{width} x {height} by its {window}"
        if by_rows and not (0 < height <= MAX_SIDE and 0 < width <= MAX_SIDE):
            raise InputError(f"{where}: expected 1…{MAX_SIDE} on each side, got {claims}")
        if not by_rows and (height < 1 or width < 1 or height * width > MAX_PIXELS):
            raise InputError(f"{where}: expected 1…{MAX_PIXELS} pixels, got {claims}")
    if _overlap(header) is None:
        raise InputError(
            f"{where}: expected a data window that overlaps the display window, got one outside it"
        )
    data, display = _area(header["dataWindow"]), _area(header["displayWindow"])
    if display > _LARGE and display > _SPARSE * data:
        height, width = _size(header["displayWindow"])
        raise InputError(
            f"{where}: expected a data window of at least 1/{_SPARSE} of the display window, got "
            f"{data} pixels in {width} x {height}"
        )
    return _area(header["dataWindow"], header["displayWindow"]) * len(names)


def _channel_names(header: Mapping[str, Any]) -> dict[str, None]:
    """In the order of the file, as the keys of a dict: what `channel_keys` takes."""
    return {channel.name: None for channel in header["channels"]}


def _corners(window: Any) -> tuple[int, int, int, int]:
    """left, top, right, bottom; the last two belong to the window."""
    (left, top), (right, bottom) = window
    return int(left), int(top), int(right), int(bottom)


def _size(window: Any) -> tuple[int, int]:
    left, top, right, bottom = _corners(window)
    return bottom - top + 1, right - left + 1


def _area(*windows: Any) -> int:
    """Pixels of the largest window."""
    return max(height * width for height, width in map(_size, windows))


def _overlap(header: Mapping[str, Any]) -> tuple[int, int, int, int] | None:
    data, display = _corners(header["dataWindow"]), _corners(header["displayWindow"])
    left, top = max(data[0], display[0]), max(data[1], display[1])
    right, bottom = min(data[2], display[2]), min(data[3], display[3])
    return (left, top, right, bottom) if left <= right and top <= bottom else None


def placed(pixels: NDArray[Any], header: Mapping[str, Any]) -> NDArray[np.float32]:
    """The data window's pixels in the display window."""
    data, display = _corners(header["dataWindow"]), _corners(header["displayWindow"])
    overlap = _overlap(header)
    if data == display or overlap is None:
        return np.ascontiguousarray(pixels, np.float32)
    left, top, right, bottom = overlap
    placed = np.zeros(_size(header["displayWindow"]), np.float32)
    placed[
        top - display[1] : bottom - display[1] + 1, left - display[0] : right - display[0] + 1
    ] = pixels[top - data[1] : bottom - data[1] + 1, left - data[0] : right - data[0] + 1]
    return placed


def _array(path: object, name: str, values: ArrayLike, half: bool) -> NDArray[Any]:
    array = np.asarray(values)
    if array.ndim != 2 or array.size == 0 or array.dtype.kind not in "fiub":
        raise InputError(
            f"{path}: channel {name!r}: expected numbers [H, W], got {array.dtype} "
            f"{list(array.shape)}"
        )
    if array.size > MAX_PIXELS:
        raise InputError(
            f"{path}: channel {name!r}: expected at most {MAX_PIXELS} pixels, got {array.size}"
        )
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, np.float16 if half else np.float32)


def _check_sizes(path: object, parts: Mapping[str, Mapping[str, NDArray[Any]]]) -> None:
    sizes: dict[tuple[int, ...], str] = {}
    for part, channels in parts.items():
        if not channels:
            raise InputError(f"{path}: part {part!r}: expected at least one channel, got none")
        for name, array in channels.items():
            if not isinstance(name, str) or not name:
                raise InputError(f"{path}: channel name: expected a text, got {name!r}")
            sizes.setdefault(array.shape, f"{part}.{name}".lstrip("."))
    if len(sizes) > 1:
        found = ", ".join(f"{name} {h} x {w}" for (h, w), name in sizes.items())
        raise InputError(
            f"{path}: expected one size (height x width) for all channels, got {found}"
        )
