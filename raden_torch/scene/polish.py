"""The mirror image in a polished face: of the surroundings, of the table, and of lamps.

Of the surroundings it is a look-up. A GGX lobe of small α about the mirror direction R is nearly
a Gaussian, so the map is blurred once for each α, read at R, and multiplied by the share of light
that the face reflects at this view: the split sum of Karis (Real shading in Unreal Engine 4,
SIGGRAPH 2013). α of 0.01 to 0.1, of polished lacquer, is what this is for.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.microfacet import albedo
from raden_torch.brdf.shading.area_lights import RectangleLight, on_rectangle
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.kept_by_map import KeptByMap
from raden_torch.brdf.shading.latlong import SphereBlur, about_y, octahedral
from raden_torch.brdf.shading.triples import as_map, checked

WIDTH = 1.35
"""Standard deviation of the Gaussian about R over α."""
_SPACING = 0.4
"""Of the blurred map's nodes, in standard deviations: wider, a flat face shows them as bands."""
_BLOCK = 1 << 18
_blurred: KeptByMap[Tensor] = KeptByMap(most=4)
"""Blurred maps by roughness."""


class MirroredSurroundings:
    """An environment as a polished face shows it."""

    def __init__(self, light: EnvironmentLight, roughness: float) -> None:
        radiance = light.radiance
        self._map = _blurred.get(
            radiance,
            roughness,
            lambda: SphereBlur(radiance).octahedral(WIDTH * roughness, _SPACING),
        )
        self._turn = about_y(-light.rotation_deg).float()
        self._factor = checked("intensity", light.intensity, may_be_one=True).float()

    def at(self, mirror: Tensor) -> Tensor:
        """`[3, N]` radiance from unit directions `[3, N]`."""
        found = []
        for part in mirror.split(_BLOCK, 1):
            u, v = octahedral(*(self._turn @ part))
            at = torch.stack([u, v], -1)[None, None]
            found.append(grid_sample(self._map[None], at, align_corners=True)[0, :, 0])
        return torch.cat(found, 1) * self._factor.view(-1, 1)


def mirrored_rectangle(light: RectangleLight, position: Tensor, mirror: Tensor) -> Tensor:
    """`[3, N]` radiance of a lamp where mirror directions from places `[3, N]` meet it.

    Its edges are sharp: a polish of small α blurs them by less than they are wide.
    """
    middle, across, up, radiance = (
        as_map(x, position[None, :, None])[0, :, 0, 0]
        for x in (light.position, light.across, light.up, light.radiance)
    )
    place, reach, facing = on_rectangle(position, mirror, middle, across, up)
    inside = (place.abs() < 0.5).all(0) & (facing < 0) & (reach > 0)
    return radiance[:, None] * inside


def reflected_share(face: Coated, cosine: Tensor) -> Tensor:
    """What the face reflects, by the cosine of the view `[N]`."""
    return albedo(face.roughness, face.index)(cosine.view(1, 1, 1, -1))[0, :, 0].to(cosine)


def mirrored(normal: Tensor, view: Tensor) -> tuple[Tensor, Tensor]:
    """The mirror direction of unit views `[3, N]`, and their cosine `[N]`, at least 0."""
    cosine = (normal * view).sum(0)
    return 2 * cosine * normal - view, cosine.clamp(min=0)
