"""OpenEXR files as named channels: whole ones read and written, and large ones written by rows.

What the pixels are is said in `exr_file.py`, which reads.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raden_torch.errors import InputError
from raden_torch.files import check_output, written_beside
from raden_torch.images.exr_file import ExrFile
from raden_torch.images.exr_header import MAX_PIXELS
from raden_torch.images.openimageio import error_of, openimageio, readable_name

WRITTEN_LINES = 16
"""Scan lines that ZIP compresses together."""
_LONGEST_NAME = 255
_STRIP = 1 << 22
_ROOM = 1 << 24
"""Bytes: more than OpenImageIO holds back when a write fails."""

Parts = dict[str, dict[str, NDArray[np.float32]]]


def read_channels(path: str | os.PathLike[str]) -> dict[str, NDArray[np.float32]]:
    """Every channel of every part, `[H, W]`, by the names that `list_channels` gives.

    Raises:
        InputError: as for `read_parts`.
    """
    file = ExrFile(path, at_once=True)
    maps = file.read([(part, name) for _, part, name in file.keys], 0, file.size[0])
    return {key: maps[part, name] for key, part, name in file.keys}


def list_channels(path: str | os.PathLike[str]) -> list[str]:
    """The names of the channels, from the header alone.

    A name is as in the file. In a multi-part file, "part.name" for each channel of a part that
    shares a name with another part.

    Raises:
        InputError: as for `read_parts`, the pixels aside.
    """
    return [key for key, _, _ in ExrFile(path, at_once=True).keys]


def read_parts(path: str | os.PathLike[str]) -> Parts:
    """`{part: {channel: [H, W]}}`; the part of a single-part file may be called "".

    Raises:
        InputError: not an OpenEXR file, truncated or damaged; deep or subsampled; more than
            `MAX_PIXELS` pixels or `MAX_VALUES` values (found before the memory is taken).
    """
    file = ExrFile(path, at_once=True)
    maps = file.read([(part, name) for _, part, name in file.keys], 0, file.size[0])
    return {
        name: {channel: maps[name, channel] for channel in part.channels}
        for name, part in file.parts.items()
    }


def write_channels(
    path: str | os.PathLike[str],
    channels: Mapping[str, ArrayLike],
    *,
    half: bool = False,
    chromaticities: tuple[float, ...] | None = None,
) -> None:
    """Write a single-part file.

    Args:
        channels: `{name: [H, W]}`, all of one size.
        half: 16-bit floats (11 bits of precision; infinite beyond 65504) instead of 32-bit ones.
        chromaticities: x, y of the primaries and of white, for the attribute of that name.

    Raises:
        InputError: arrays that are not `[H, W]` or differ in size, a name that OpenEXR cannot hold,
            a suffix other than .exr, a folder that does not exist.
    """
    write_parts(path, {"": channels}, half=half, chromaticities=chromaticities)


def write_parts(
    path: str | os.PathLike[str],
    parts: Mapping[str, Mapping[str, ArrayLike]],
    *,
    half: bool = False,
    chromaticities: tuple[float, ...] | None = None,
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
    size = _one_size(path, arrays)
    target = check_output(path, (".exr",))
    with written_beside(target) as temporary, _written(temporary, path) as file:
        specs = [
            _spec(path, part, channels, size, chromaticities) for part, channels in arrays.items()
        ]
        file.open(specs)
        for number, (spec, channels) in enumerate(zip(specs, arrays.values(), strict=True)):
            if number:
                file.next_part(spec)
            step = max(_STRIP // (size[1] * len(channels)) // WRITTEN_LINES, 1) * WRITTEN_LINES
            for top in range(0, size[0], step):
                file.add(top, [a[top : top + step] for a in channels.values()])


@contextmanager
def rows_written(
    path: str | os.PathLike[str],
    size: tuple[int, int],
    chromaticities: tuple[float, ...] | None = None,
) -> Iterator[Callable[[Mapping[str, NDArray[np.float16]]], None]]:
    """Yield a function that adds rows to a file of this height and width, from the top down.

    It takes `{channel: [rows, W]}`. The file appears when the block ends, with all its rows; it is
    the one that `write_channels` makes.

    Raises:
        InputError: the folder does not exist, or ``path`` is a folder.
    """
    top = 0
    target = check_output(path, (".exr",))
    with written_beside(target) as temporary, _written(temporary, path) as file:

        def add(channels: Mapping[str, NDArray[np.float16]]) -> None:
            nonlocal top
            if top == 0:
                file.open([_spec(path, "", channels, size, chromaticities)])
            rows = list(channels.values())
            file.add(top, rows)
            top += len(rows[0])

        yield add
        if top != size[0]:
            raise InputError(f"{path}: expected {size[0]} rows, got {top}")


class _Output:
    """OpenImageIO's writer, whose failures are errors.

    Args:
        name: of the file that it writes.
        meant: the file that messages name.
    """

    def __init__(self, name: str, meant: object) -> None:
        self._name, self._meant = name, meant
        self._file: Any = openimageio().ImageOutput.create("openexr")

    def open(self, specs: Sequence[Any]) -> None:
        self._check(self._file.open(self._name, tuple(specs)))

    def next_part(self, spec: Any) -> None:
        self._check(self._file.open(self._name, spec, "AppendSubimage"))

    def add(self, top: int, rows: Sequence[NDArray[Any]]) -> None:
        """`[rows, W]` of each channel."""
        pixels = np.stack(rows, axis=-1)
        self._check(self._file.write_scanlines(top, top + len(pixels), 0, pixels))

    def close(self) -> None:
        self._check(self._file.close())

    def _check(self, done: bool) -> None:
        if not done or self._file.has_error:
            reason = error_of(self._file).replace(self._name, str(self._meant))
            raise InputError(f"{self._meant}: OpenImageIO cannot write it: {reason}")


@contextmanager
def _written(temporary: Path, meant: object) -> Iterator[_Output]:
    try:
        with readable_name(temporary) as name:
            output = _Output(name, meant)
            yield output
            output.close()
        ExrFile(temporary).check_whole()  # OpenImageIO writes its last bytes without a check
    except InputError as error:
        _check_room(temporary)
        raise InputError(str(error).replace(str(temporary), str(meant))) from None


def _check_room(temporary: Path) -> None:
    """Raise the OSError that OpenImageIO does not tell, where the file cannot grow."""
    with open(temporary, "ab", buffering=0) as file:
        for _ in range(_ROOM >> 16):
            file.write(bytes(1 << 16))


def _spec(
    path: object,
    part: str,
    channels: Mapping[str, NDArray[Any]],
    size: tuple[int, int],
    chromaticities: tuple[float, ...] | None = None,
) -> Any:
    oiio = openimageio()
    for text in (part, *channels):
        _check_name(path, text)
    kind = oiio.HALF if next(iter(channels.values())).dtype == np.float16 else oiio.FLOAT
    spec = oiio.ImageSpec(size[1], size[0], len(channels), kind)
    spec.channelnames = tuple(channels)
    spec.attribute("compression", "zip")
    spec.attribute("DateTime", "")  # or it writes the time, and no two files are the same
    if part:
        spec.attribute("oiio:subimagename", part)
    if chromaticities is not None:
        spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), tuple(chromaticities))
    return spec


def _check_name(path: object, text: str) -> None:
    try:
        length = len(text.encode())
    except UnicodeEncodeError:
        length = -1
    if not 0 <= length <= _LONGEST_NAME or "\0" in text:
        raise InputError(
            f"{path}: name of a channel or part: expected at most {_LONGEST_NAME} bytes of text, "
            f"got {text!r}"
        )


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
        return np.asarray(array, np.float16 if half else np.float32)


def _one_size(path: object, parts: Mapping[str, Mapping[str, NDArray[Any]]]) -> tuple[int, int]:
    """Height and width of all channels."""
    sizes: dict[tuple[int, int], str] = {}
    for part, channels in parts.items():
        if not channels:
            raise InputError(f"{path}: part {part!r}: expected at least one channel, got none")
        for name, array in channels.items():
            if not isinstance(name, str) or not name:
                raise InputError(f"{path}: channel name: expected a text, got {name!r}")
            height, width = array.shape
            sizes.setdefault((height, width), f"{part}.{name}".lstrip("."))
    if len(sizes) > 1:
        found = ", ".join(f"{name} {h} x {w}" for (h, w), name in sizes.items())
        raise InputError(
            f"{path}: expected one size (height x width) for all channels, got {found}"
        )
    return next(iter(sizes))
