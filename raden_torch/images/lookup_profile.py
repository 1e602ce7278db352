"""ICC profiles of lookup tables, as scanners and printers have them, by LittleCMS in floats.

Pillow's LittleCMS converts RGB of 8 bits alone, so imagecodecs' is taken. What is matrix and curves
stays ours (`icc.py`): it needs no other package, and a table of 65,536 values is faster.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.colorimetry import SRGB
from raden_torch.errors import InputError
from raden_torch.packages import require

_RELATIVE_COLORIMETRIC = 1
_ROWS = 256


@dataclass(frozen=True)
class LookupProfile:
    """A profile whose colours are no matrix with curves.

    Attributes:
        data: the profile.
        path: of the file that it is in, for messages.
    """

    data: bytes
    path: str | os.PathLike[str]

    def linear(self, stored: NDArray[Any], white: float) -> NDArray[np.float32]:
        """`[H, W, 3]` whole numbers → linear RGB of sRGB's primaries, unclipped.

        Args:
            white: the stored value that stands for 1.

        Raises:
            InputError: a profile that LittleCMS cannot follow.
        """
        require("colour profiles of lookup tables", "icc")
        import imagecodecs

        red, green, blue, (x, y) = (SRGB[:2], SRGB[2:4], SRGB[4:6], SRGB[6:])
        primaries = (*red, 1.0, *green, 1.0, *blue, 1.0)
        found = np.empty(stored.shape, np.float32)
        try:
            target = imagecodecs.cms_profile(
                "rgb", whitepoint=(x, y, 1.0), primaries=primaries, gamma=1.0
            )
            for top in range(0, len(stored), _ROWS):
                rows = np.ascontiguousarray(stored[top : top + _ROWS] / white, np.float32)
                found[top : top + _ROWS] = imagecodecs.cms_transform(
                    rows,
                    self.data,
                    target,
                    colorspace="rgb",
                    outcolorspace="rgb",
                    outdtype="f4",
                    intent=_RELATIVE_COLORIMETRIC,
                )
        except (RuntimeError, ValueError) as error:
            raise InputError(
                f"{self.path}: expected a colour profile that LittleCMS can follow, got a damaged "
                f"one ({' '.join(str(error).split())})"
            ) from None
        if not np.isfinite(found).all():
            raise InputError(f"{self.path}: expected a colour profile of finite colours, got NaN")
        return found
