"""Are these vectors normals, and are they stored as they are or as (n + 1)/2?

Decided for a whole image, by counts that add up over its parts: an image that is read some rows at
a time is decoded as if it were read at once.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import torch
from torch import Tensor

UNIT_SHARE = 0.8
"""A bare RGB image holds normals where this share of its pixels that are not black has length 1."""
UNIT_TOLERANCE = 0.02
_STRIP_ROWS = 64
_LEAST_LENGTH = 0.1
"""Of a decoded normal; what is shorter was grey, which stands for none."""


@dataclass(frozen=True)
class Evidence:
    """Counts of pixels.

    Attributes:
        vectors: that are finite and not zero.
        negative: of these, with a component below −`UNIT_TOLERANCE`.
        unit: of length 1, within `UNIT_TOLERANCE`.
        nearer_decoded: nearer to length 1 as 2n − 1 than as n.
        decoded, decoded_negative, decoded_unit: the first three of the vectors 2n − 1.
    """

    vectors: int = 0
    negative: int = 0
    unit: int = 0
    nearer_decoded: int = 0
    decoded: int = 0
    decoded_negative: int = 0
    decoded_unit: int = 0

    @classmethod
    def of(cls, vectors: Tensor) -> Evidence:
        """Of `[B, 3, H, W]` as stored."""
        v = vectors.movedim(1, -1)[_there(vectors)[:, 0]]
        off = (_length(v) - 1).abs()
        decoded = 2 * v - 1
        length = _length(decoded)
        kept = length > _LEAST_LENGTH
        counted = (
            _is_negative(v),
            off < UNIT_TOLERANCE,
            (length - 1).abs() < off,
            kept,
            kept & _is_negative(decoded),
            kept & ((length - 1).abs() < UNIT_TOLERANCE),
        )
        return cls(len(v), *(int(mask.sum()) for mask in counted))

    def __add__(self, other: Evidence) -> Evidence:
        return Evidence(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def is_coded(self) -> bool:
        """Whether normals are stored as (n + 1)/2: none is negative, and most come nearer to unit
        length by decoding them."""
        return self.negative == 0 and 2 * self.nearer_decoded > self.vectors

    @property
    def is_normals(self) -> bool:
        """Whether these are unit vectors at all, as stored or decoded.

        Some component must be negative: an image of pure red and blue has unit colours, too.
        """
        if self.is_coded:
            return self.decoded_negative > 0 and self.decoded_unit >= UNIT_SHARE * self.decoded
        return self.negative > 0 and self.unit >= UNIT_SHARE * self.vectors


def has_negative(vectors: Tensor) -> bool:
    """Whether `[B, 3, H, W]` as stored cannot be coded: cheaper than `Evidence.of`."""
    strips = vectors.split(_STRIP_ROWS, dim=-2)  # most often the first one has some
    return any(bool(((v < -UNIT_TOLERANCE) & _there(v)).any()) for v in strips)


def decoded(normal: Tensor, is_coded: bool) -> Tensor:
    """Normals `[B, 3, H, W]` as stored → −1…1, and 0 where there are none.

    Where they are coded, black pixels and grey ones (0.5, 0.5, 0.5) have no normal.
    """
    if not is_coded and bool(torch.isfinite(normal.sum())):
        return normal  # all are finite, and zero vectors are none
    there = _there(normal)
    if is_coded:
        normal = 2 * normal - 1
        there = there & (_length(normal.movedim(1, -1))[:, None] > _LEAST_LENGTH)
    return torch.where(there, normal, torch.zeros_like(normal))


def _there(vectors: Tensor) -> Tensor:
    """`[B, 1, H, W]`: finite and not zero."""
    finite = torch.isfinite(vectors).all(dim=1, keepdim=True)
    return finite & (vectors != 0).any(dim=1, keepdim=True)


def _length(vectors: Tensor) -> Tensor:
    """Of `[..., 3]`."""
    x, y, z = vectors.unbind(-1)
    return (x * x + y * y + z * z).sqrt()


def _is_negative(vectors: Tensor) -> Tensor:
    return (vectors < -UNIT_TOLERANCE).any(dim=-1)
