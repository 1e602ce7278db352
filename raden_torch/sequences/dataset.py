"""Frames as a dataset for torch's `DataLoader`: each is read when it is asked for."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import IterableDataset, get_worker_info

from raden_torch.brdf.files.gbuffer_file import GBufferFile, has_pixels
from raden_torch.brdf.files.gbuffer_reading import GBufferReading
from raden_torch.brdf.files.image_file import read_photograph
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.errors import InputError, check_type
from raden_torch.sequences.frames import frame_numbers, frame_path, frames_on_disk
from raden_torch.sequences.picture_job import Shape
from raden_torch.sequences.plan import check_pattern, missing
from raden_torch.sequences.render_job import shape_of_exr

Frame = dict[str, Tensor]
_MAPS = tuple(field.name for field in fields(GBuffer))


class FrameDataset(IterableDataset[Frame]):
    """EXR G-buffers of a sequence, and pictures beside them, read one by one in their order.

    For `torch.utils.data.DataLoader`: workers share the frames out, so that each comes once, and in
    order where a batch is one frame. No more than the frames being read are in memory.

    A frame is a dict of tensors: `frame`, its number; `normal` `[3, H, W]`, `mask` `[1, H, W]` and
    whatever else the file has for `GBuffer`, without the batch's dimension; and each of `pictures`,
    `[3, H, W]`, linear RGB of sRGB's primaries.

    Args:
        gbuffer: the files, as "shot.####.exr".
        frames: as "1001-1240" or "1-10x2,15", or numbers; None for all that are on disk.
        pictures: other files of each frame by the name that they get, as
            `{"target": "lit.####.exr"}`: what `read_photograph` reads, of the G-buffer's size.
        skip_missing: leave out frames whose files are missing.
        reading: attributes of `GBufferReading`, as in `fov_deg=40`.

    Attributes:
        frames: their numbers.
        size: height and width of all frames.

    Raises:
        InputError: missing files, with their numbers; when a frame is read: what `read_gbuffer`
            raises; channels or a size other than the first frame's.

    Examples:
        >>> import tempfile
        >>> import numpy as np
        >>> import raden_torch as rt
        >>> from raden_torch.images.exr import write_channels
        >>> folder = tempfile.mkdtemp()
        >>> flat = {"N.X": np.zeros((2, 4)), "N.Y": np.zeros((2, 4)), "N.Z": np.ones((2, 4))}
        >>> for number in (1, 2, 3):
        ...     write_channels(f"{folder}/shot.{number:04d}.exr", flat)
        >>> frames = rt.FrameDataset(f"{folder}/shot.####.exr", "1-3x2")
        >>> [(int(frame["frame"]), list(frame["normal"].shape)) for frame in frames]
        [(1, [3, 2, 4]), (3, [3, 2, 4])]
    """

    def __init__(
        self,
        gbuffer: str | os.PathLike[str],
        frames: str | Iterable[int] | None = None,
        *,
        pictures: Mapping[str, str | os.PathLike[str]] | None = None,
        skip_missing: bool = False,
        **reading: Any,
    ) -> None:
        check_type("FrameDataset gbuffer", gbuffer, (str, os.PathLike))
        self._gbuffer = Path(gbuffer)
        check_pattern(self._gbuffer)
        self._pictures = {name: Path(path) for name, path in (pictures or {}).items()}
        for name, path in self._pictures.items():
            check_pattern(path)
            if name in (*_MAPS, "frame"):
                raise InputError(f"pictures: expected a name that is no map's, got {name!r}")
        self._reading = GBufferReading(**reading)
        if frames is None:
            asked = frames_on_disk(self._gbuffer)
        else:
            asked = sorted(set(frame_numbers(frames) if isinstance(frames, str) else frames))
        self.frames = self._there(asked, skip_missing)
        if not self.frames:
            raise InputError(f"{self._gbuffer}: expected frames, got none")
        self._first = frame_path(self._gbuffer, self.frames[0])
        self._shape = shape_of_exr(self._first)

    @property
    def size(self) -> tuple[int, int]:
        return self._shape.size

    def __iter__(self) -> Iterator[Frame]:
        worker = get_worker_info()
        start, step = (0, 1) if worker is None else (worker.id, worker.num_workers)
        for number in self.frames[start::step]:
            yield self._read(number)

    def gbuffer(self, batch: Frame) -> GBuffer:
        """What `shade` takes, of a frame or of a batch of them."""
        maps = {name: batch[name] for name in _MAPS if name in batch}
        if maps["normal"].ndim == 3:
            maps = {name: value[None] for name, value in maps.items()}
        return GBuffer(**maps)

    def _there(self, asked: list[int], skip_missing: bool) -> list[int]:
        patterns = (self._gbuffer, *self._pictures.values())
        gone = {
            pattern: [n for n in asked if not frame_path(pattern, n).is_file()]
            for pattern in patterns
        }
        for pattern, numbers in gone.items():
            if numbers and not skip_missing:
                raise missing(pattern, asked, numbers, "; `skip_missing=True` leaves them out")
        left_out = set().union(*gone.values())
        return [number for number in asked if number not in left_out]

    def _read(self, number: int) -> Frame:
        path = frame_path(self._gbuffer, number)
        file = GBufferFile(path, self._reading, is_checked=path == self._first)
        self._shape.check(path, Shape(file.size, file.channels), self._first)
        gbuffer = file.rows(0, file.size[0])
        if not has_pixels(gbuffer):
            raise file.is_empty()
        found: Frame = {"frame": torch.tensor(number)}
        for name in _MAPS:
            value = getattr(gbuffer, name)
            if value is not None:
                is_map = isinstance(value, Tensor) and value.ndim == 4
                found[name] = value[0] if is_map else torch.as_tensor(value, dtype=torch.float32)
        for name, pattern in self._pictures.items():
            beside = frame_path(pattern, number)
            picture = read_photograph(beside).linear[0]
            height, width = picture.shape[1:]
            Shape(self.size, ()).check(beside, Shape((height, width), ()), path)
            found[name] = picture
        return found
