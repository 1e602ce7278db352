"""A lacquered plate with a raden motif, made by code (Take 2012, fig. 11)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from raden_torch.artwork.lacquer import Lacquer
from raden_torch.artwork.motif import inlay
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import Light
from raden_torch.brdf.shading.shade import shade
from raden_torch.brdf.shading.sphere_gbuffer import camera_rays, check_rays
from raden_torch.errors import InputError

_DOME, _ROLL, _ROLL_WIDTH, _CORNER = 0.06, 0.025, 0.10, 0.12


@dataclass(frozen=True)
class InlaidPlate:
    """A lacquered plate in two layers whose masks add up to its silhouette.

    Attributes:
        shell: the pieces of raden; their normals lean piece by piece.
        lacquer: the urushi around them, one smooth surface.
        piece: `[1, 1, H, W]`, the number of the piece that lies there, 0 where there is none.
    """

    shell: GBuffer
    lacquer: GBuffer
    piece: Tensor


def plate(
    size: int = 512,
    camera: tuple[float, float, float] = (0.0, -2.6, 4.2),
    *,
    samples: int = 2,
    margin: float = 1.08,
) -> InlaidPlate:
    """A slightly domed lacquer plate with a raden motif, −1…1 in x and y, facing +z.

    Args: as for `sphere`; the camera stands above the plate (z > 0.5).
    """
    check_rays("plate", size, samples)
    eye = torch.tensor(camera, dtype=torch.float64, device="cpu")
    if not float(eye[2]) > 0.5:
        raise InputError(f"plate: camera: expected z > 0.5, above the plate, got {camera}")
    half_width = 1.08 * margin / float(eye.norm())
    rays = camera_rays(eye, size * samples, half_width)
    x, y, z = _on_dome(eye, rays)
    pixel = 2 * half_width * float(eye.norm()) / (size * samples)
    silhouette = (_edge_distance(x, y) / pixel + 0.5).clamp(0, 1)
    maps = inlay(x, y, pixel)
    coverage, lean = maps.coverage[0], maps.layer_slope
    slope = torch.stack(_dome_slope(x, y))
    smooth, cut = _normal(slope), _normal(slope + lean)
    position = torch.stack([x, y, z]).float()[None]

    def layer(normal: Tensor, mask: Tensor) -> GBuffer:
        return GBuffer(normal, position=position, camera=camera, mask=mask.float()[None, None])

    return InlaidPlate(
        shell=layer(cut, silhouette * coverage),
        lacquer=layer(smooth, silhouette * (1 - coverage)),
        piece=maps.piece.clamp(min=0)[None],
    )


def shade_plate(model: Reflection, plate: InlaidPlate, lights: Sequence[Light]) -> Tensor:
    """Scene-linear RGB of the plate: shell by the model, urushi by `Lacquer`.

    A simulated shell is the light from its films and body; the mirror image in the coat above it is
    added here. A measured shell was measured through its coat. Of a palette, the pieces show the
    materials in turn.
    """
    members = model if isinstance(model, Palette) else Palette([model])
    material = plate.piece % len(members)
    shell = replace(plate.shell, material=material)
    image = shade(members, shell, lights) + shade(Lacquer(), plate.lacquer, lights)
    coated = torch.tensor([is_simulated_shell(member) for member in members])
    if bool(coated.any()):
        gloss = shade(Lacquer(base=(0.0, 0.0, 0.0)), plate.shell, lights)
        image = image + gloss * coated[material]
    return image


def is_simulated_shell(material: Reflection) -> bool:
    """A shell as film optics make it, without a coat."""
    models = material if isinstance(material, AnisotropicBrdf) else [material]
    sources = [getattr(m, "provenance", None) for m in models]
    return all(source is not None and source.simulated for source in sources)


def _dome(x: Tensor, y: Tensor) -> Tensor:
    """Height: a shallow dome whose rim rolls off."""
    rim = (1 - _edge_distance(x, y) / _ROLL_WIDTH).clamp(0, 1)
    return _DOME * (1 - (x * x + y * y) / 2) - _ROLL * rim**3


def _dome_slope(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """∂z/∂x and ∂z/∂y by central differences (the rim has no closed form worth its lines)."""
    e = 1e-4
    return (
        (_dome(x + e, y) - _dome(x - e, y)) / (2 * e),
        (_dome(x, y + e) - _dome(x, y - e)) / (2 * e),
    )


def _edge_distance(x: Tensor, y: Tensor) -> Tensor:
    """Distance to the rounded square's edge, positive inside."""
    qx, qy = x.abs() - 1 + _CORNER, y.abs() - 1 + _CORNER
    outside = torch.sqrt(qx.clamp(min=0) ** 2 + qy.clamp(min=0) ** 2)
    return _CORNER - outside - torch.maximum(qx, qy).clamp(max=0)


def _on_dome(eye: Tensor, rays: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Where rays meet the dome: a few steps from plane to height and back."""
    z = torch.zeros_like(rays[0])
    for _ in range(6):
        reach = (z - eye[2]) / rays[2].clamp(max=-1e-6)
        x, y = eye[0] + reach * rays[0], eye[1] + reach * rays[1]
        z = _dome(x.clamp(-1, 1), y.clamp(-1, 1))
    return x, y, z


def _normal(slope: Tensor) -> Tensor:
    """`[1, 3, H, W]` unit normals of a height field's slopes `[2, H, W]`."""
    n = torch.cat([-slope, torch.ones_like(slope[:1])])
    return (n / n.norm(dim=0)).float()[None]
