"""A camera's unknown response, recovered from 8-bit photographs of several exposures."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from raden_torch.arrays import Floats32
from raden_torch.errors import InputError
from raden_torch.images.pixels import read_image
from raden_torch.images.raw import is_raw


def recover_response(
    paths: Sequence[str | os.PathLike[str]],
    exposures_s: Sequence[float],
    *,
    samples: int = 300,
) -> Floats32:
    """The unknown response of 8-bit photographs: stored value → linear, `[256, 3]`, 1 at 255.

    Debevec and Malik, Recovering High Dynamic Range Radiance Maps from Photographs (1997), through
    OpenCV. Give the result to `read_linear(coded=…)`.

    Raises:
        InputError: fewer than three exposures, not 8-bit, different sizes, or a response that does
            not rise (the scene moved, or the times are wrong).
    """
    import cv2

    if len(paths) < 3 or len(paths) != len(exposures_s) or len(set(exposures_s)) < 3:
        raise InputError(
            f"response: expected three or more different exposures, got {len(paths)} photographs "
            f"and {len(exposures_s)} exposure times"
        )
    stored = []
    for path in paths:
        if is_raw(path) or (pixels := read_image(path).rgb).dtype != np.uint8:
            raise InputError(
                f"{path}: expected 8 bits, got more; raw and 16-bit files need no response"
            )
        stored.append(pixels)
        if pixels.shape != stored[0].shape:
            raise InputError(f"{path}: expected the size of {paths[0]}, got another")
    solver = cv2.createCalibrateDebevec(samples, 20.0, False)
    curve = solver.process(stored, np.asarray(exposures_s, np.float32)).reshape(256, 3)
    middle = curve[16:240]
    if not np.isfinite(curve).all() or (np.diff(middle[::16], axis=0) <= 0).any():
        raise InputError(
            f"{paths[0]} and the others: no rising response fits them; did the camera or the scene "
            "move, or are the exposure times wrong?"
        )
    # its ends hang on few pixels: they may not fall
    curve = np.maximum.accumulate(curve, axis=0)
    return np.asarray(curve / curve[-1], np.float32)
