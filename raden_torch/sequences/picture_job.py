"""What all jobs that write a picture of each frame share: names, sizes, what is kept."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Self

from raden_torch.errors import InputError
from raden_torch.files import write_once
from raden_torch.images.openimageio import opened, openimageio
from raden_torch.packages import require
from raden_torch.sequences.frames import frame_path
from raden_torch.sequences.job import Job, Prepared, Read, Worked


@dataclass(frozen=True)
class Shape:
    """What all frames of a sequence have in common.

    Attributes:
        size: height and width in pixels.
        channels: by name.
    """

    size: tuple[int, int]
    channels: tuple[str, ...]

    def check(self, path: Path, other: Shape, first: Path) -> None:
        """Raise InputError where a frame is not like the first one.

        Args:
            path, other: the frame.
        """
        if other.size != self.size:
            (height, width), (h, w) = self.size, other.size
            raise InputError(
                f"{path}: expected {width} x {height} pixels, as {first.name} has, got {w} x {h}"
            )
        if other.channels != self.channels:
            lacks = [name for name in self.channels if name not in other.channels]
            has = [name for name in other.channels if name not in self.channels]
            said = [f"without {', '.join(lacks)}"] * bool(lacks) + [
                f"with {', '.join(has)}"
            ] * bool(has)
            raise InputError(
                f"{path}: expected the channels of {first.name}, got them {' and '.join(said)}"
            )


UNKNOWN = Shape((0, 0), ())
"""Before the first frame has been looked at."""


@dataclass(frozen=True, kw_only=True)
class PictureJob(Job[int, Prepared, Read, Worked]):
    """A picture of each frame.

    Attributes:
        target: the files to write, with a place for the frame's number.
        force: replace pictures that are there.
        picture_size: height and width of a picture, where it is known before.
    """

    target: Path
    force: bool = False
    picture_size: tuple[int, int] | None = None

    @property
    @abstractmethod
    def patterns(self) -> tuple[Path, ...]:
        """Files that are read for each frame, with a place for its number."""

    def inputs(self, item: int) -> list[Path]:
        return [frame_path(pattern, item) for pattern in self.patterns]

    def output(self, item: int) -> Path:
        return frame_path(self.target, item)

    def is_done(self, item: int) -> bool:
        path = self.output(item)
        if self.force or not path.exists():
            return False
        if self.picture_size is not None and (found := image_size(path)) != self.picture_size:
            (height, width), (h, w) = self.picture_size, found
            raise InputError(
                f"{path}: expected a picture of {width} x {height} pixels to keep, got {w} x {h}; "
                "`force` replaces it"
            )
        return True

    def put(self, item: int, write: Callable[[Path], object]) -> bool:
        """Let the picture be written, as `Job.write` says."""
        return write_once(self.output(item), write, replace=self.force)

    def relocated(self, places: Mapping[Path, Path]) -> Self:
        return relocated(self, places)


def import_codecs() -> None:
    """Import what reads and writes pictures, before threads do: while OpenCV is being imported,
    another thread finds it missing."""
    require("pictures", "images")
    import cv2  # noqa: F401
    from PIL import Image  # noqa: F401

    openimageio()


def relocated(settings: Any, places: Mapping[Path, Path]) -> Any:
    """A dataclass in which paths, also those in dataclasses of it, are replaced by others."""
    changed: dict[str, Any] = {}
    for field in fields(settings):
        value = getattr(settings, field.name)
        if isinstance(value, Path):
            changed[field.name] = places.get(value, value)
        elif isinstance(value, str) and Path(value) in places:  # a name, or a file
            changed[field.name] = str(places[Path(value)])
        elif hasattr(value, "__dataclass_fields__"):
            changed[field.name] = relocated(value, places)
    return replace(settings, **changed)


def image_size(path: Path) -> tuple[int, int]:
    """Height and width of an image file, by its header.

    Raises:
        InputError: OpenImageIO cannot open it.
    """

    def damaged(reason: str) -> InputError:
        return InputError(f"{path}: expected a picture to keep, got a damaged one ({reason})")

    with opened(path, damaged) as file:
        spec = file.spec()
        return spec.full_height, spec.full_width
