"""What a camera sees of a scene: places, gathered once for all lights, and their radiance."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from raden_torch.artwork.box import LID, TABLE, Box, Hits
from raden_torch.brdf.materials.urushi import black_urushi
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import Light
from raden_torch.geometry import unit_columns
from raden_torch.scene.camera import View
from raden_torch.scene.dressing import Dressed, Dressing
from raden_torch.scene.lighting import Face, SeenBox
from raden_torch.scene.mirror_image import MirrorImage
from raden_torch.scene.samples import Samples, sampled
from raden_torch.scene.table import LitTable, Table

_FAR = 1e4
"""Where a camera at infinity is put."""


class Seen:
    """What a camera sees: places on the box, or on a surface, and on the table.

    Args:
        samples: all places.
        box: those on the box or the surface.
        size: of the picture.
        image: of the box in the table, and the table's face, where it is polished.
    """

    def __init__(
        self,
        samples: Samples,
        box: SeenBox,
        size: tuple[int, int],
        image: tuple[MirrorImage, Face] | None = None,
    ) -> None:
        self._box, self._size, self._mirror_image = box, size, image
        part = samples.hits.part
        self._on_box, self._on_table = samples.at(part >= LID), samples.at(part == TABLE)

    @classmethod
    def of(cls, dressing: Dressing, box: Box, view: View, table: Table | None) -> Seen:
        """By casting rays."""
        camera = view.camera
        samples = sampled(box, camera, view.per_side)
        on_box = samples.at(samples.hits.part >= LID).hits
        dressed = dressing.at(box, on_box, camera.eye(), view.pixel)
        seen = SeenBox(dressing, dressed, camera.position)
        image = None
        if table is not None and table.roughness is not None:
            on_table = samples.at(samples.hits.part == TABLE)
            hits, share = on_table.hits, torch.ones_like(on_table.hits.position[0])
            polish = black_urushi(table.roughness)
            face = Face.of(polish, hits.normal, hits.position, camera.position, share)
            image = MirrorImage(dressing, box, view, table.roughness, on_table.pixel), face
        return cls(samples, seen, camera.size, image)

    def image(self, lights: Sequence[Light], table: LitTable | None) -> Tensor:
        """`[1, 3, H, W]` radiance under lights, and of a table under the same."""
        image = self._on_box.averaged(self._box.radiance(lights, table), self._size)
        places = self._on_table
        if table is None or not len(places.pixel):
            return image
        radiance = table.radiance(places.hits.position)
        if self._mirror_image is not None:
            mirror_image, face = self._mirror_image
            before = mirror_image.at(places.pixel, lights, table)
            radiance *= 1 - face.reflects
            radiance += face.reflected(lights, None, before)
        return image + places.averaged(radiance, self._size)


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
