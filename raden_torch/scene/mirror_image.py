"""A box's mirror image in a polished table, by the camera below the table that sees it directly.

The box is seen once a pixel from the mirrored camera, and its picture is blurred: a lobe of GGX α
is a Gaussian about the mirror direction (`polish.py`), so what lies t₂ behind a place of the table
that is t₁ away is blurred by that Gaussian's width times t₂ / (t₁ + t₂), in angles of the camera.
At the foot of the box the image is sharp, and farther up it dissolves.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate, pad

from raden_torch.artwork.box import LID, Box, Hits
from raden_torch.brdf.shading.lights import Light
from raden_torch.scene.camera import View
from raden_torch.scene.dressing import Dressing
from raden_torch.scene.lighting import SeenBox
from raden_torch.scene.polish import WIDTH
from raden_torch.scene.table import LitTable

_MARGIN = 4
"""Pixels around those that show the table: their image is blurred into it."""
_SIGMA = 0.95
"""Of a level of the pyramid that is read bilinearly, in its own pixels."""
_SPREAD = 4
"""The level by which the blur is carried on beyond the image's outline."""


class MirrorImage:
    """The mirror image of a box, whatever lights it.

    Args:
        roughness: α of the table.
        shown: `[P]` which pixels show the table, row by row.
    """

    def __init__(
        self, dressing: Dressing, box: Box, view: View, roughness: float, shown: Tensor
    ) -> None:
        camera, pixel = view.camera, view.pixel
        width, height = camera.size
        self._size = height, width
        x, y, z = camera.position
        wanted = _widened(shown, self._size, _MARGIN)
        rays = camera.rays(wanted % width + 0.5, wanted // width + 0.5)
        rays[1].neg_()
        reach = y / rays[1].clamp(min=1e-9)  # to the table, on the way to the box
        eye = torch.tensor((x, -y, z))
        table = eye[:, None] + rays * reach
        near = ((rays[1] > 1e-9) & (box.covers(table, rays) > 0)).nonzero()[:, 0]
        rays, reach = rays.index_select(1, near), reach[near]
        hits = box.cast(eye, rays)
        on = (hits.part >= LID).nonzero()[:, 0]
        self._pixel = wanted[near[on]]
        hits = Hits(hits.part[on], hits.position[:, on], hits.normal[:, on])
        dressed = dressing.at(box, hits, eye, pixel)
        self._box = SeenBox(dressing, dressed, (x, -y, z))
        whole = (hits.position - eye[:, None]).square().sum(0).sqrt()
        first = reach[on] * rays[:, on].square().sum(0).sqrt()
        blur = WIDTH * roughness * (1 - first / whole).clamp(min=0) / pixel
        self._level = self._levels_of(blur)

    def at(
        self, pixel: Tensor, lights: Sequence[Light], table: LitTable | None
    ) -> tuple[Tensor, Tensor]:
        """Radiance `[3, P]` at pixels `[P]`, times the cover; and the cover `[P]`, 0…1."""
        radiance = self._box.radiance(lights, table)
        covered = torch.cat([radiance, torch.ones_like(radiance[:1])])
        blurred = self._blurred(self._spread(covered))
        found = blurred.flatten(1).index_select(1, pixel)
        return found[:3], found[3].clamp(0, 1)

    def _spread(self, values: Tensor) -> Tensor:
        """`[C, H, W]` of values `[C, N]`; 0 elsewhere."""
        image = values.new_zeros(len(values), self._size[0] * self._size[1])
        image[:, self._pixel] = values
        return image.view(len(values), *self._size)

    def _levels_of(self, blur: Tensor) -> Tensor:
        """`[H, W]` levels of the pyramid that have a blur in pixels, also beside the image."""
        level = (blur / _SIGMA).clamp(min=1).log2()
        flat = _pyramid(self._spread(torch.stack([level, torch.ones_like(level)])), _SPREAD)[-1]
        wide = interpolate(flat[None], size=self._size, mode="bilinear")[0]
        image = wide[0] / wide[1].clamp(min=1e-6)
        image.view(-1)[self._pixel] = level
        return image

    def _blurred(self, image: Tensor) -> Tensor:
        most = int(self._level.amax().ceil()) if self._level.numel() else 0
        total = torch.zeros_like(image)
        for k, level in enumerate(_pyramid(image, most)):
            weight = (1 - (self._level - k).abs()).clamp(min=0)
            full = level
            if k:
                full = interpolate(level[None], size=self._size, mode="bilinear")[0]
            total.addcmul_(full, weight)
        return total


def _pyramid(image: Tensor, most: int) -> list[Tensor]:
    """`[C, H, W]` and each half as large as the last."""
    levels = [image]
    for _ in range(most):
        last = levels[-1]
        if min(last.shape[1:]) < 4:
            break
        odd = pad(last, (0, last.shape[2] % 2, 0, last.shape[1] % 2), mode="replicate")
        half = pad(avg_pool2d(odd, 2), (1, 1, 1, 1), mode="replicate")
        across = (half[..., :-2] + 2 * half[..., 1:-1] + half[..., 2:]) / 4
        levels.append((across[:, :-2] + 2 * across[:, 1:-1] + across[:, 2:]) / 4)
    return levels


def _widened(shown: Tensor, size: tuple[int, int], margin: int) -> Tensor:
    """Pixels that are shown or lie within a margin of those that are."""
    mask = torch.zeros(size)
    mask.view(-1)[shown] = 1
    side = 2 * margin + 1
    near = torch.nn.functional.max_pool2d(mask[None], side, 1, margin)[0]
    return near.flatten().nonzero()[:, 0]
