"""What a camera sees of a scene: places, gathered once for all lights, and their radiance."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from raden_torch.artwork.box import LID, TABLE, Box, Hits
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import Light
from raden_torch.geometry import unit_columns
from raden_torch.scene.camera import Camera
from raden_torch.scene.dressing import Dressed, Dressing
from raden_torch.scene.lighting import SeenBox
from raden_torch.scene.samples import Samples, sampled
from raden_torch.scene.table import LitTable

_FAR = 1e4
"""Where a camera at infinity is put."""


class Seen:
    """What a camera sees: places on the box, or on a surface, and on the table.

    Args:
        samples: all places.
        box: those on the box or the surface.
        size: of the picture.
    """

    def __init__(self, samples: Samples, box: SeenBox, size: tuple[int, int]) -> None:
        self._box, self._size = box, size
        part = samples.hits.part
        self._on_box, self._on_table = samples.at(part >= LID), samples.at(part == TABLE)

    @classmethod
    def of(cls, dressing: Dressing, box: Box, camera: Camera, per_side: int, pixel: float) -> Seen:
        """By casting rays.

        Args:
            per_side: samples along each side of a pixel at an edge.
            pixel: the angle that it spans.
        """
        samples = sampled(box, camera, per_side)
        on_box = samples.at(samples.hits.part >= LID).hits
        dressed = dressing.at(box, on_box, camera.eye(), pixel)
        return cls(samples, SeenBox(dressing, dressed, camera.position), camera.size)

    def image(self, lights: Sequence[Light], table: LitTable | None) -> Tensor:
        """`[1, 3, H, W]` radiance under lights, and of a table under the same."""
        image = self._on_box.averaged(self._box.radiance(lights, table), self._size)
        if table is not None and len(self._on_table.pixel):
            radiance = table.radiance(self._on_table.hits.position)
            image += self._on_table.averaged(radiance, self._size)
        return image


def of_gbuffer(gbuffer: GBuffer, dressing: Dressing) -> Seen:
    """Of an EXR: a place a pixel, where there is a normal."""
    normal = torch.nn.functional.normalize(gbuffer.normal[0].float(), dim=0)
    _, height, width = normal.shape
    found = torch.isfinite(normal).all(0) & (normal.norm(dim=0) > 0.5)
    mask = torch.ones(height, width) if gbuffer.mask is None else gbuffer.mask[0, 0].float()
    found = (found & (mask > 0)).flatten()
    pixel = found.nonzero()[:, 0]
    n = normal.flatten(1)[:, pixel]
    if gbuffer.position is not None and gbuffer.camera is not None:
        position = gbuffer.position[0].float().flatten(1)[:, pixel]
        eye = tuple(float(x) for x in torch.as_tensor(gbuffer.camera).flatten()[:3])
    else:
        position = torch.zeros_like(n)
        view = torch.as_tensor(gbuffer.view_map(gbuffer.normal)).flatten()[:3].float()
        eye = tuple((view / view.norm() * _FAR).tolist())
    chart = dressing.charts.get(LID)
    if chart is None:
        weights = torch.zeros(len(dressing.coverings), len(pixel))
        weights[dressing.ground] = 1
        bent = n
    else:
        weights = chart.weights.flatten(1)[:, pixel]
        slope = chart.layers.flatten(1)[:, pixel]
        right = n.new_tensor([1.0, 0.0, 0.0])[:, None]
        up = n.new_tensor([0.0, 1.0, 0.0])[:, None]
        bent = unit_columns(n - slope[0] * right - slope[1] * up)
    weights = weights * mask.flatten()[pixel]
    hits = Hits(torch.full_like(pixel, LID), position, n)
    samples = Samples(hits, pixel, torch.ones_like(pixel))
    dressed = Dressed(position, (n, bent, n), weights)
    box = SeenBox(dressing, dressed, (eye[0], eye[1], eye[2]))
    return Seen(samples, box, (width, height))
