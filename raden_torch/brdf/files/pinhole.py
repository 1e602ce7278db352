"""A pinhole camera's matrix, and the rays through its pixels."""

from __future__ import annotations

from math import inf, radians, tan

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from raden_torch.errors import InputError

Y_UP = (1.0, -1.0, -1.0)
"""x right, y down, z forward → x right, y up, z to the viewer."""


def pinhole_matrix(
    intrinsics: Tensor | ArrayLike | None,
    fov_deg: float | None,
    size: tuple[int, int],
    pixel_aspect: float = 1.0,
) -> Tensor | None:
    """`[3, 3]` float32 in pixels, y down; None where neither is given.

    Args:
        fov_deg: the horizontal angle of view of the pixels around the centre of `size`, which is
            height and width.
        pixel_aspect: width over height of a pixel, for `fov_deg`.
    """
    if intrinsics is not None and fov_deg is not None:
        raise InputError("camera: expected intrinsics or fov_deg, got both")
    height, width = size
    if fov_deg is not None:
        if not 0 < fov_deg < 180:
            raise InputError(f"`fov_deg`: expected an angle between 0 and 180, got {fov_deg:g}")
        if not 0 < pixel_aspect < inf:
            raise InputError(f"pixel aspect ratio: expected above 0, got {pixel_aspect:g}")
        focal = width / 2 / tan(radians(fov_deg) / 2)
        centre_x, centre_y = (width - 1) / 2, (height - 1) / 2
        intrinsics = np.array(
            [[focal, 0, centre_x], [0, focal * pixel_aspect, centre_y], [0, 0, 1]]
        )
    if intrinsics is None:
        return None
    matrix = torch.as_tensor(intrinsics, dtype=torch.float32, device="cpu")
    usable = matrix.shape == (3, 3) and bool(torch.isfinite(matrix).all())
    if not usable or float(matrix[0, 0]) <= 0 or float(matrix[1, 1]) <= 0:
        raise InputError(
            "intrinsics: expected a matrix [3, 3] with focal lengths above 0, got "
            f"{matrix.tolist()}"
        )
    return matrix


def rays(matrix: Tensor, top: int, bottom: int, width: int) -> Tensor:
    """`[1, 3, rows, W]` from the camera through each pixel, with −1 along z (y up)."""
    inverse = torch.linalg.inv(matrix.double()) * matrix.new_tensor(Y_UP).double()[:, None]
    u, v, one = inverse[:, :, None, None].unbind(1)
    across = u * torch.arange(width, dtype=torch.float64, device=matrix.device) + one
    down = v * torch.arange(top, bottom, dtype=torch.float64, device=matrix.device)[:, None]
    return torch.stack([(a + d).float() for a, d in zip(across, down, strict=True)])[None]
