"""A lacquer board with the same motif cut of several shells, under a window and a dim room."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.artwork.cutting import PieceMaps, cut
from raden_torch.artwork.flowers import butterfly, chrysanthemum, leaf
from raden_torch.artwork.lacquer import Lacquer
from raden_torch.artwork.layers import HABITS
from raden_torch.artwork.pieces import ShellPiece
from raden_torch.artwork.plate import is_simulated_shell
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.runtime import models_of
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import DirectionalLight, Light
from raden_torch.brdf.shading.shade import shade
from raden_torch.brdf.shading.sphere_gbuffer import average_samples

CAMERA = (0.0, -2.6, 5.0)
_DOME = 0.04  # the board is a little domed, as lids are
_HEIGHT = 1.44


def board_pieces(shells: Sequence[str]) -> Iterator[ShellPiece]:
    """The motif, once for each shell, side by side at a distance of 1."""
    for index, shell in enumerate(shells):
        x = index - (len(shells) - 1) / 2
        yield from chrysanthemum(x + 0.02, -0.17, 0.40, 16, shell=shell, heart=shell)
        yield from butterfly(x + 0.10, 0.46, 0.22, math.radians(140), shell=shell, spots=shell)
        yield from leaf(x - 0.18, 0.10, 0.30, math.radians(112), shell=shell)
        yield from leaf(x + 0.24, -0.44, 0.24, math.radians(-38), shell=shell)


def broad_light() -> list[DirectionalLight]:
    """A window behind the board on the left, and the room about it, as 72 distant lamps."""
    centre = torch.tensor([-0.12, 0.74, 0.66])
    centre = centre / centre.norm()
    right = torch.linalg.cross(torch.tensor([0.0, 0.0, 1.0]), centre)
    up = torch.linalg.cross(centre, right)
    lights = []
    for across in torch.linspace(-0.45, 0.45, 8):
        for along in torch.linspace(-0.22, 0.22, 6):
            x, y, z = (centre + across * right + along * up).tolist()
            lights.append(DirectionalLight((x, y, z), (3.0 / 48,) * 3))
    for k in range(24):
        z, turn = 0.08 + 0.92 * (k + 0.5) / 24, 2.39996 * k
        r = math.sqrt(1 - z * z)
        lights.append(
            DirectionalLight((r * math.cos(turn), r * math.sin(turn), z), (0.3 / 24,) * 3)
        )
    return lights


def shade_board(
    models: Mapping[str, Mapping[float, RadenBrdf]], width: int = 1400, *, samples: int = 1
) -> Tensor:
    """`[1, 3, H, width]` scene-linear RGB of a board.

    Args:
        models: of each shell by name, its models by their tablet scale (`simulate_specimen`).
        width: of the picture in pixels.
        samples: rays per pixel along each side; edges are smooth without.
    """
    shells = list(models)
    board = _board(shells, width, samples)
    scales = {name: tuple(sorted(own)) for name, own in models.items()}
    weights = board.maps.weights(scales) * board.maps.coverage
    lights = broad_light()
    image = _urushi(board, lights, CAMERA, board.maps.coverage.float()[None])
    layers = _normal(board.slope + board.maps.layer_slope)
    each = [(name, scale) for name, own in scales.items() for scale in own]
    for weight, (name, scale) in zip(weights.float(), each, strict=True):
        seen = GBuffer(layers, position=board.position, camera=CAMERA, mask=weight[None, None])
        image = image + shade(models[name][scale], seen, lights)
    return average_samples(image, samples)


def shade_materials(
    palette: Palette,
    lights: Sequence[Light],
    width: int = 1400,
    *,
    camera: tuple[float, float, float] = CAMERA,
    samples: int = 1,
) -> Tensor:
    """`[1, 3, H, width]` scene-linear RGB of a board: the motif in each material of a palette.

    Shells that have no habit of their own (by the member's name) are cut like yakogai; what is no
    shell does not lean. A simulated shell has the gloss of the coat above it.
    """
    habits = [name if name in HABITS else "yakogai" for name in palette.names]
    board = _board(habits, width, samples)
    x = board.position[:, :1]
    panel = (x + len(palette) / 2).long().clamp(0, len(palette) - 1)
    is_shell = torch.tensor([bool(models_of(member)) for member in palette])
    lean = board.maps.layer_slope * is_shell[panel[0]]
    inlaid = GBuffer(
        _normal(board.slope + lean),
        position=board.position,
        camera=camera,
        mask=board.maps.coverage.float()[None],
        material=panel,
    )
    glossy = torch.tensor([is_simulated_shell(member) for member in palette])[panel]
    image = _urushi(board, lights, camera, board.maps.coverage.float()[None], glossy)
    return average_samples(image + shade(palette, inlaid, lights), samples)


@dataclass(frozen=True, eq=False)
class _Board:
    """Slopes `[2, H, W]`, positions `[1, 3, H, W]` and the maps of the pieces."""

    slope: Tensor
    position: Tensor
    maps: PieceMaps


def _board(shells: Sequence[str], width: int, samples: int) -> _Board:
    pixel = len(shells) / (width * samples)
    across = (torch.arange(width * samples, dtype=torch.float64) + 0.5) * pixel - len(shells) / 2
    rows = round(_HEIGHT * width / len(shells)) * samples
    down = _HEIGHT / 2 - (torch.arange(rows, dtype=torch.float64) + 0.5) * pixel
    y, x = torch.meshgrid(down, across, indexing="ij")
    maps = cut(list(board_pieces(shells)), x, y, pixel, seed=1)
    slope = torch.stack([-_DOME * x, -_DOME * y])
    return _Board(slope, torch.stack([x, y, torch.zeros_like(x)]).float()[None], maps)


def _urushi(
    board: _Board,
    lights: Sequence[Light],
    camera: tuple[float, float, float],
    coverage: Tensor,
    glossy: Tensor | float = 1.0,
) -> Tensor:
    """The lacquer between the pieces, and the gloss above those that have it."""
    ground, gloss = (
        _lacquer(lacquer, board.slope, board.position, lights, camera)
        for lacquer in (Lacquer(), Lacquer(base=(0.0, 0.0, 0.0)))
    )
    return ground * (1 - coverage) + gloss * (coverage * glossy)


def _lacquer(
    lacquer: Coated,
    slope: Tensor,
    position: Tensor,
    lights: Sequence[Light],
    camera: tuple[float, float, float],
) -> Tensor:
    """The board all in lacquer. It is smooth: one sample in 8 x 8 will do."""
    thin = torch.nn.functional.avg_pool2d
    normal, place = _normal(thin(slope, 8, ceil_mode=True)), thin(position, 8, ceil_mode=True)
    image = shade(lacquer, GBuffer(normal, position=place, camera=camera), lights)
    size = slope.shape[-2:]
    return torch.nn.functional.interpolate(image, size=size, mode="bilinear")


def _normal(slope: Tensor) -> Tensor:
    """`[1, 3, H, W]` unit normals of a height field's slopes `[2, H, W]`."""
    n = torch.cat([-slope, torch.ones_like(slope[:1])])
    return (n / n.norm(dim=0)).float()[None]
