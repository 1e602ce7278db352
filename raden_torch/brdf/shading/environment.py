"""Light from all around: an environment map, and the distant lamps that stand for it."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.arrays import Floats
from raden_torch.brdf.shading import latlong
from raden_torch.brdf.shading.kept_by_map import KeptByMap
from raden_torch.brdf.shading.triples import Colour, checked
from raden_torch.colorimetry import SRGB_LUMINANCE
from raden_torch.errors import InputError, check_type

LARGEST = 2**27
"""Texels of a map: 16384 x 8192."""
_USUAL_LAMPS = 512
"""Where nothing faster serves, and no number is asked for."""
_checked: KeptByMap[None] = KeptByMap()
"""Maps that were found good: a light is made anew by every `replace`."""
_MOST_KEPT = 4096
"""Lamps of one map that are kept from frame to frame."""
_kept_lamps: KeptByMap[DistantLamps] = KeptByMap(most=8)
"""By number and intensity, before they are turned."""


@dataclass(frozen=True, eq=False)
class DistantLamps:
    """Many lamps at infinity, as one: an environment, sampled.

    Attributes:
        directions: `[K, 3]` towards them.
        irradiance: `[K, 3]` linear RGB, on a plane that faces each.
        visibility: `[B, 1, H, W]`, how much of it each pixel of the image sees, 0…1.
    """

    directions: Tensor
    irradiance: Tensor
    visibility: Tensor | None = None

    def __len__(self) -> int:
        return len(self.directions)

    def split(self, count: int) -> Iterator[DistantLamps]:
        """The same in parts of at most `count` lamps."""
        for d, e in zip(self.directions.split(count), self.irradiance.split(count), strict=True):
            yield DistantLamps(d, e, self.visibility)


@dataclass(frozen=True, eq=False)
class EnvironmentLight:
    """What surrounds the scene, infinitely far away, as a lat-long map.

    Attributes:
        radiance: `[3, H, 2H]` linear RGB; first row up (+y), middle column along −z, x to the
            right (docs/conventions.md).
        rotation_deg: turns it about +y, counter-clockwise seen from above.
        intensity: multiplies it; one number or linear RGB.
        samples: how it is summed. None: prefiltered, one look-up a pixel (`surroundings.py`),
            and distant lamps where that does not serve: with gradients, and for surfaces that
            have layers, tangents or several materials. A number: as many distant lamps, by median
            cut. "all": every texel is a lamp, the reference; slow.
        tolerance: what 99 % of a prefiltered frame may be wrong by for being read from a table,
            of the frame's peak.
        visibility: `[B, 1, H, W]`, how much of it each pixel of the image sees, 0…1.

    Raises:
        InputError: a shape that is no lat-long map; texels that are negative, NaN or infinite.

    Examples:
        >>> import torch
        >>> from raden_torch.brdf.shading.environment import EnvironmentLight
        >>> grey = EnvironmentLight(torch.full((3, 8, 16), 0.5))
        >>> lamps = grey.lamps(16)
        >>> [round(x, 3) for x in lamps.irradiance.sum(dim=0).tolist()]  # 0.5 x 4 pi
        [6.283, 6.283, 6.283]
    """

    radiance: Tensor
    rotation_deg: float = 0.0
    intensity: Colour = 1.0
    samples: int | Literal["all"] | None = None
    tolerance: float = 0.01
    visibility: Tensor | None = None

    def __post_init__(self) -> None:
        check_type("EnvironmentLight: radiance", self.radiance, Tensor, "use torch.as_tensor(x)")
        where = "EnvironmentLight: radiance"
        _checked.get(self.radiance, None, lambda: check_map(where, self.radiance))
        checked("EnvironmentLight: intensity", self.intensity, may_be_one=True)
        if not np.isfinite(self.rotation_deg):
            raise InputError(
                f"EnvironmentLight: rotation_deg: expected a finite angle, got {self.rotation_deg}"
            )
        if self.samples not in (None, "all") and not (
            isinstance(self.samples, int) and 1 <= self.samples <= self.radiance[0].numel()
        ):
            raise InputError(
                f"EnvironmentLight: samples: expected 1…{self.radiance[0].numel()} lamps, "
                f'"all" or None, got {self.samples!r}'
            )

    def scaled(self) -> Tensor:
        """`[3, H, W]` radiance with its intensity."""
        factor = checked("intensity", self.intensity, may_be_one=True)
        return self.radiance * factor.to(self.radiance).view(3, 1, 1)

    def lamps(self, count: int | Literal["all"] | None = None) -> DistantLamps:
        """Distant lamps with the irradiance of the whole map.

        Median cut (Debevec 2005): the map is cut in two of equal energy, and again the part with
        the most energy times width, until there are enough; each part shines from its middle.
        Irradiance is differentiable in the radiance.
        """
        _, height, width = self.radiance.shape
        weighted = self.scaled().double() * latlong.solid_angles(height, width).to(
            self.radiance.device
        )
        turn = latlong.about_y(self.rotation_deg)
        towards = torch.einsum("ij,jhw->ihw", turn, latlong.directions(height, width))
        count = count or (self.samples or _USUAL_LAMPS)
        if count == "all" or count >= height * width:
            kept = weighted.flatten(1).T
            return DistantLamps(towards.flatten(1).T.to(kept), kept)
        energy = torch.einsum("c,chw->hw", weighted.new_tensor(SRGB_LUMINANCE), weighted.detach())
        parts = _median_cut(energy.cpu().numpy(), count)
        label = torch.from_numpy(_labels(parts, (height, width))).flatten().to(weighted.device)
        irradiance = weighted.new_zeros(len(parts), 3).index_add(0, label, weighted.flatten(1).T)
        # the middle of each part, by its energy; of what is black, by its area
        mass = energy + 1e-9 * energy.mean() + 1e-300
        middle = (towards.to(mass) * mass).flatten(1).T
        direction = irradiance.new_zeros(len(parts), 3).index_add(0, label, middle)
        return DistantLamps(torch.nn.functional.normalize(direction, dim=1, eps=1e-300), irradiance)

    @torch.no_grad()
    def kept_lamps(self, count: int | Literal["all"] | None = None) -> DistantLamps:
        """`lamps` without gradient, kept for as long as the map is, unchanged."""
        count = count or (self.samples or _USUAL_LAMPS)
        if count == "all" or count > _MOST_KEPT:
            return self.lamps(count)
        # the cut is by luminance, so a coloured intensity changes it
        factor = checked("intensity", self.intensity, may_be_one=True).flatten().tolist()
        still = replace(self, rotation_deg=0.0)
        lamps = _kept_lamps.get(self.radiance, (count, *factor), lambda: still.lamps(count))
        turn = latlong.about_y(self.rotation_deg).to(lamps.directions)
        return DistantLamps(lamps.directions @ turn.T, lamps.irradiance)


def check_map(where: str, radiance: Tensor) -> None:
    """Raise InputError where it is no lat-long map of light."""
    shape = list(radiance.shape)
    if len(shape) != 3 or shape[0] != 3 or shape[2] != 2 * shape[1] or shape[1] < 1:
        raise InputError(
            f"{where}: expected a lat-long map [3, H, 2H], got {shape}; a cross, a cube or a "
            "mirror ball has to be converted first"
        )
    if shape[1] * shape[2] > LARGEST:
        raise InputError(f"{where}: expected at most {LARGEST} texels, got {shape}; scale it down")
    if not radiance.is_floating_point():
        raise InputError(f"{where}: expected linear floating-point RGB, got {radiance.dtype}")
    wrong = ~(torch.isfinite(radiance) & (radiance >= 0))
    if bool(wrong.any()):
        channel, row, column = (int(i) for i in wrong.nonzero()[0])
        raise InputError(
            f"{where}: expected finite values of 0 or more, got "
            f"{float(radiance[channel, row, column]):g} in channel {'RGB'[channel]}, row {row}, "
            f"column {column} ({int(wrong.sum())} in all)"
        )


Part = tuple[int, int, int, int]
"""First and last + 1 of rows and columns."""


def _median_cut(energy: Floats, count: int) -> list[Part]:
    height, width = energy.shape
    table = np.zeros((height + 1, width + 1))
    table[1:, 1:] = energy.cumsum(0).cumsum(1)

    def size(part: Part) -> tuple[float, float]:
        top, bottom, left, right = part
        wide = np.sin(np.pi * (top + bottom) / 2 / height) * (right - left) * (2 * np.pi / width)
        return (bottom - top) * np.pi / height, float(wide)

    def ranked(part: Part) -> tuple[float, Part]:
        top, bottom, left, right = part
        inside = table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left]
        splits = bottom - top > 1 or right - left > 1
        return (-(inside + 1e-12 * table[-1, -1]) * max(size(part)) if splits else 1.0, part)

    heap = [ranked((0, height, 0, width))]
    while len(heap) < count and heap[0][0] <= 0:
        _, part = heapq.heappop(heap)
        for half in _halves(part, table, *size(part)):
            heapq.heappush(heap, ranked(half))
    return [part for _, part in heap]


def _halves(part: Part, table: Floats, high: float, wide: float) -> list[Part]:
    """Two of equal energy, cut across the longer side."""
    top, bottom, left, right = part
    by_rows = bottom - top > 1 and (high >= wide or right - left == 1)
    if by_rows:
        share = table[top : bottom + 1, right] - table[top : bottom + 1, left]
    else:
        share = table[bottom, left : right + 1] - table[top, left : right + 1]
    share = share - share[0]
    cut = int(np.abs(share[1:-1] - share[-1] / 2).argmin()) + 1
    if share[-1] <= 0:
        cut = len(share) // 2
    if by_rows:
        return [(top, top + cut, left, right), (top + cut, bottom, left, right)]
    return [(top, bottom, left, left + cut), (top, bottom, left + cut, right)]


def _labels(parts: list[Part], shape: tuple[int, int]) -> NDArray[np.int64]:
    labels = np.empty(shape, np.int64)
    for number, (top, bottom, left, right) in enumerate(parts):
        labels[top:bottom, left:right] = number
    return labels
