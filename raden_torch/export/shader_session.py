"""Running an exported shader fast in ONNX Runtime: only the pixels that show, in tiles."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raden_torch.arrays import Floats32
from raden_torch.errors import InputError, check_type, why
from raden_torch.export.constants import fix_parameters
from raden_torch.export.runtimes import Arrays, one_line, onnx_session
from raden_torch.packages import require

TILE, _ROW = 32_768, 4096
"""Pixels a call, and in a row of the map: maps, and what is turned from one order into another row
by row, stay in the processor's caches."""


class ShaderSession:
    """A shader in ONNX Runtime that computes only pixels whose mask is above 0.

    The pixels of each image are gathered into tiles, which threads take in turn. A thread has its
    own buffers, used for all of its tiles: ONNX Runtime reads and writes them in place. The form's
    parameters are constants here: `run` takes the maps, the mask, the light and the exposure.

    Args:
        file: what `export_onnx` wrote: its path, or its bytes.
        tile: pixels a call.
        threads: that compute tiles; 0 for one a processor. Several threads on one small tile would
            mostly wait for each other.
        parameters: other values of the file's parameters, as `{"table": …}` of another shell in the
            same shape.

    Raises:
        InputError: no such file, not an ONNX file, a parameter that does not fit, or onnxruntime is
            missing.
    """

    def __init__(
        self,
        file: str | os.PathLike[str] | bytes,
        *,
        tile: int = TILE,
        threads: int = 0,
        parameters: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        check_type("ShaderSession tile", tile, (int, Integral))
        check_type("ShaderSession threads", threads, (int, Integral))
        if tile < 1:
            raise InputError(f"ShaderSession: tile: expected at least 1 pixel, got {tile}")
        if threads < 0:
            raise InputError(f"ShaderSession: expected 0 threads or more, got {threads}")
        data = file if isinstance(file, bytes) else _read(Path(file))
        self._parameters = {name: _real(name, value) for name, value in (parameters or {}).items()}
        self._session = onnx_session(_fixed(data, self._parameters), threads=1)
        try:
            required = self._session.get_inputs()
            optional = self._session.get_overridable_initializers()
            self._shapes = {i.name: tuple(i.shape) for i in (*required, *optional)}
            self._required = {i.name for i in required}
            self._output = self._session.get_outputs()[0].name
        except UnicodeDecodeError:
            raise InputError("ShaderSession: cannot load it: names that are not UTF-8") from None
        if "normal" not in self._required:
            raise InputError(
                "ShaderSession: expected a file of export_onnx, got one without an input `normal`"
            )
        self._tile = tile
        self._data, self._threads = data, threads or os.cpu_count() or 1
        self._pool, self._process = ThreadPoolExecutor(self._threads), os.getpid()
        self._own = threading.local()

    def __reduce__(self) -> tuple[Any, ...]:
        """As the file's bytes: a session goes to other processes, as a data loader's workers."""
        options = partial(
            type(self), tile=self._tile, threads=self._threads, parameters=self._parameters
        )
        return options, (self._data,)

    def run(self, **inputs: ArrayLike) -> Floats32:
        """The shader's output.

        Args:
            inputs: by the names in the file, with its shapes; converted to float32.

        Returns:
            `[B, 3, H, W]`; 0 where the mask is not above 0.

        Raises:
            InputError: an input is missing, unknown, or of a shape that does not fit.
        """
        given = self._checked(inputs)
        if self._process != os.getpid():  # a forked child has none of its parent's threads
            self._pool, self._process = ThreadPoolExecutor(self._threads), os.getpid()
        batch, _, height, width = given["normal"].shape
        image = np.zeros((batch, 3, height * width), np.float32)
        for index in range(batch):
            maps, constants = self._split(given, index)
            job = partial(self._run_tile, maps, constants, image[index])
            for _ in self._pool.map(job, self._tiles(given, index)):
                pass  # each writes its own pixels; this raises what a thread raised
        return image.reshape(batch, 3, height, width)

    def _checked(self, inputs: Mapping[str, ArrayLike]) -> Arrays:
        missing, unknown = self._required - set(inputs), set(inputs) - set(self._shapes)
        if missing or unknown:
            what = f"missing {sorted(missing)}" if missing else f"unknown {sorted(unknown)}"
            raise InputError(
                f"ShaderSession: expected inputs {', '.join(self._shapes)}, got {what}"
            )
        given = {name: _real(name, value) for name, value in inputs.items()}
        if given["normal"].ndim != 4:
            raise InputError(
                "ShaderSession: normal: expected shape [batch, 3, height, width], got "
                f"{list(given['normal'].shape)}"
            )
        for name, value in given.items():
            wanted = self._shapes[name]
            if value.ndim != len(wanted) or not _fits(value, wanted, given["normal"].shape):
                raise InputError(
                    f"ShaderSession: {name}: expected shape {list(wanted)}, got {list(value.shape)}"
                )
        return given

    def _split(self, given: Arrays, index: int) -> tuple[Arrays, Arrays]:
        """One image's maps as `[C, H·W]`, and what is the same for all of its pixels."""
        size = given["normal"].shape[2:]
        maps, constants = {}, {}
        for name, value in given.items():
            if _is_batched(self._shapes[name]):
                value = value[min(index, len(value) - 1)][None]
            if _is_map(self._shapes[name]) and (name == "normal" or value.shape[2:] != (1, 1)):
                whole = np.broadcast_to(value[0], (value.shape[1], *size))
                maps[name] = whole.reshape(len(whole), -1)
            else:
                constants[name] = np.ascontiguousarray(value)
        return maps, constants

    def _tiles(self, given: Arrays, index: int) -> Iterator[slice | NDArray[np.intp]]:
        """The pixels to compute, a tile at a time; a slice where they are all in a row, which is
        copied in a tenth of the time."""
        size = given["normal"].shape[2:]
        if "mask" not in given:
            count = size[0] * size[1]
            for start in range(0, count, self._tile):
                yield slice(start, min(start + self._tile, count))
            return
        mask = given["mask"]
        mask = mask[min(index, len(mask) - 1), 0]
        pixels = np.flatnonzero(np.broadcast_to(mask, size) > 0)
        for start in range(0, len(pixels), self._tile):
            tile = pixels[start : start + self._tile]
            first, last = int(tile[0]), int(tile[-1])
            yield slice(first, last + 1) if last - first + 1 == len(tile) else tile

    def _run_tile(
        self, maps: Arrays, constants: Arrays, image: Floats32, pixels: slice | NDArray[np.intp]
    ) -> None:
        """Put these pixels into the image `[3, H·W]`."""
        count = pixels.stop - pixels.start if isinstance(pixels, slice) else len(pixels)
        binding = self._session.io_binding()
        for name, value in constants.items():
            _bind(binding.bind_input, name, value)
        for name, value in maps.items():
            tile = self._buffer(name, len(value), count)
            if isinstance(pixels, slice):
                tile.reshape(len(value), -1)[:] = value[:, pixels]
            else:
                np.take(value, pixels, axis=1, out=tile.reshape(len(value), -1), mode="clip")
            _bind(binding.bind_input, name, tile)
        result = self._buffer(" output", 3, count)
        _bind(binding.bind_output, self._output, result)
        try:
            self._session.run_with_iobinding(binding)
        except Exception as error:  # its errors share no base class but this one
            raise InputError(f"ShaderSession: onnxruntime refused: {one_line(error)}") from None
        image[:, pixels] = result.reshape(3, -1)

    def _buffer(self, name: str, channels: int, pixels: int) -> Floats32:
        """`[1, channels, rows, pixels a row]`, contiguous, at the start of memory that the thread
        keeps. `[…, pixels, 1]` takes twice as long."""
        buffers: Arrays = self._own.__dict__
        if name not in buffers:
            buffers[name] = np.empty(channels * self._tile, np.float32)
        rows = pixels // _ROW if pixels % _ROW == 0 else 1
        return buffers[name][: channels * pixels].reshape(1, channels, rows, -1)


def _bind(bind: Any, name: str, value: Floats32) -> None:
    bind(name, "cpu", 0, np.float32, value.shape, value.ctypes.data)


def _real(name: str, value: ArrayLike) -> Floats32:
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "fiub":
            raise TypeError(f"expected numbers, got {array.dtype}")
        return np.asarray(array, np.float32)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"ShaderSession: {name}: {one_line(error)}") from None


def _is_batched(shape: tuple[int | str, ...]) -> bool:
    return bool(shape) and str(shape[0]).startswith("batch")


def _is_map(shape: tuple[int | str, ...]) -> bool:
    return len(shape) == 4 and _is_batched(shape)


def _fits(value: Floats32, wanted: tuple[int | str, ...], normal: tuple[int, ...]) -> bool:
    """Whether sizes are the fixed ones, those of the normals, or 1 where that holds for all."""
    sizes = dict(zip(("batch", "height", "width"), (normal[0], *normal[2:]), strict=True))
    for size, name in zip(value.shape, wanted, strict=True):
        if isinstance(name, int):
            fits = size == name
        else:
            kind, _, shared = name.partition("_of_")
            fits = size == sizes.get(kind, size) or (bool(shared) and size == 1)
        if not fits:
            return False
    return True


def _fixed(data: bytes, parameters: Arrays) -> bytes:
    """The file with its parameters as constants, which a tile must not pack again."""
    require("exported shaders", "export")
    import onnx

    try:
        graph = fix_parameters(onnx.load_from_string(data), parameters)
        return bytes(graph.SerializeToString())
    except InputError as error:
        raise InputError(f"ShaderSession: {error}") from None
    except Exception as error:  # protobuf's errors share no base class but this one
        raise InputError(f"ShaderSession: cannot load it: {one_line(error)}") from None


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: expected an exported .onnx file, got {why(error)}") from None
