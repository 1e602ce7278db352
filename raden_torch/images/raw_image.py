"""What a raw file holds, and the light and the colours that are made of it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats, Floats32
from raden_torch.errors import InputError
from raden_torch.images.mosaic import demosaiced


@dataclass(frozen=True, eq=False)
class RawColour:
    """The file's way from the camera's RGB to sRGB's.

    Attributes:
        matrix: `[3, 3]`, linear RGB of the camera, balanced → linear RGB of sRGB's primaries.
        balance: `[3]` multipliers of the camera's RGB, 1 at least.
        source: where both are from, in words.
    """

    matrix: Floats
    balance: Floats
    source: str

    @property
    def to_srgb(self) -> Floats:
        """`[3, 3]`: linear RGB of the camera → linear RGB of sRGB's primaries."""
        return np.asarray(self.matrix * self.balance)


@dataclass(frozen=True, eq=False)
class RawImage:
    """A raw file, cut to what the camera means to be seen, and turned as its orientation says.

    Attributes:
        values: `[H, W]` of a mosaic or a grey camera, `[H, W, 3]` of a linear DNG: whole numbers,
            after the file's own linearisation.
        pattern: the Bayer pattern of the picture as it is turned; None where it is no mosaic.
        black: what the sensor counts in the dark: `[2, 2]` of the cells of a mosaic, `[1]` or
            `[3]`.
        white: what it counts where it is saturated.
        colour: None where nobody knows this camera's.
        tags: EXIF's.
        notes: what the file asks for beside, and is not done.
    """

    values: NDArray[np.uint16]
    pattern: str | None
    black: Floats
    white: float
    colour: RawColour | None
    tags: Mapping[int, Any]
    notes: tuple[str, ...]

    @property
    def is_grey(self) -> bool:
        return self.pattern is None and self.values.ndim == 2

    def linear(self, white: float | None = None) -> Floats32:
        """`[H, W, 1 or 3]`: 0 at the black level, 1 at the white; noise may be below 0.

        Args:
            white: the stored value that becomes 1; None: the file's.
        """
        top = self.white if white is None else white
        if self.pattern is None:
            values = self.values.reshape(*self.values.shape[:2], -1)
            return ((values - self.black) / (top - self.black)).astype(np.float32)
        found = np.empty(self.values.shape, np.float32)
        for row, column in np.ndindex(2, 2):
            black = np.float32(self.black[row, column])
            part = self.values[row::2, column::2] - black
            found[row::2, column::2] = part / (np.float32(top) - black)
        return found[..., None]


def raw_in_colour(image: RawImage, path: str | os.PathLike[str]) -> Floats32:
    """`[H, W, 3]` linear RGB of sRGB's primaries by the file's own colours, for a picture.

    What is saturated is white: the balanced colours of the camera are cut off at 1.

    Raises:
        InputError: a camera whose colours nobody knows.
    """
    linear = image.linear()
    if image.is_grey:
        return np.repeat(linear, 3, 2)
    if image.colour is None:
        raise InputError(
            f"{path}: expected a camera whose colour matrix is in the file or known to LibRaw, got "
            "an unknown one; `raden capture colour` measures its colours"
        )
    if image.pattern is not None:
        linear = demosaiced(linear[..., 0], image.pattern)
    balanced = np.minimum(linear * image.colour.balance.astype(np.float32), 1)
    return np.asarray(balanced @ image.colour.matrix.T.astype(np.float32))
