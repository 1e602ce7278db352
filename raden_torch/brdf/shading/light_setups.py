"""Lights as a photographer sets them up for lacquerware, as maps of what the object sees."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from raden_torch.brdf.shading import latlong
from raden_torch.brdf.shading.area_lights import on_rectangle
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.errors import InputError

LightSetup = Literal["tent", "window", "softbox"]
_ROWS = 128
_FINER = 4
"""Directions a texel, along each side: edges are smooth."""
_Place = tuple[float, float, float]


def light_setup(name: LightSetup) -> EnvironmentLight:
    """What stands around an object at the origin, seen from there; x right, y up, z to the camera.

    The object is taken to be small beside the distances, in metres. Radiance is 1 where a lamp or
    a lit cloth shines at its full.

    Args:
        name: "tent", a light tent: white cloth all around, 0.6 m wide, lit from above (1 there,
            0.35 at the floor), with a round opening of 0.12 m for the camera. "window": a window of
            1.2 m x 1.5 m, 1.5 m to the left, 0.6 m up and 0.5 m forward, cut by a cross of 6 cm
            bars, in a room of radiance 0.03; a white card of 0.5 m, 0.6 m to the right, gives 0.15.
            "softbox": one of 0.6 m x 0.9 m, 0.9 m above and 0.4 m behind the object, aimed at it,
            brightest in its middle, in a dark room (0.01), as a gloss is shown to run over lacquer.

    Raises:
        InputError: another name.

    Examples:
        >>> from raden_torch.brdf.shading.light_setups import light_setup
        >>> tuple(light_setup("window").radiance.shape)
        (3, 128, 256)
    """
    painters: dict[str, Callable[[Tensor], Tensor]] = {
        "tent": _tent,
        "window": _window,
        "softbox": _softbox,
    }
    if name not in painters:
        raise InputError(
            f"light setup: expected one of {', '.join(get_args(LightSetup))}, got {name!r}"
        )
    towards = latlong.directions(_ROWS * _FINER, 2 * _ROWS * _FINER)
    grey = avg_pool2d(painters[name](towards)[None, None], _FINER)[0, 0]
    return EnvironmentLight(grey.float().expand(3, -1, -1).contiguous())


def _tent(towards: Tensor) -> Tensor:
    _, y, z = towards
    half, opening = 0.3, 0.06
    cloth = 0.35 + 0.65 * ((y + 1) / 2) ** 1.5
    return torch.where(z > half / (half**2 + opening**2) ** 0.5, 0.0, cloth)


def _window(towards: Tensor) -> Tensor:
    wide, high, bar = 1.2, 1.5, 0.06
    x, y = _on_facing(towards, (-1.5, 0.6, 0.5), wide, high)
    pane = (x.abs() < wide / 2) & (y.abs() < high / 2) & (x.abs() > bar / 2) & (y.abs() > bar / 2)
    card_x, card_y = _on_facing(towards, (0.6, 0.0, 0.2), 0.5, 0.5)
    card = (card_x.abs() < 0.25) & (card_y.abs() < 0.25)
    return torch.where(pane, 1.0, torch.where(card, 0.15, 0.03)).double()


def _softbox(towards: Tensor) -> Tensor:
    wide, high = 0.6, 0.9
    x, y = _on_facing(towards, (0.0, 0.9, -0.4), wide, high)
    inside = (x.abs() < wide / 2) & (y.abs() < high / 2)
    cloth = 1 - 0.5 * ((x / wide) ** 2 + (y / high) ** 2) * 2
    return torch.where(inside, cloth, 0.01)


def _on_facing(towards: Tensor, middle: _Place, wide: float, high: float) -> tuple[Tensor, Tensor]:
    """Where rays from the origin meet the plane of a rectangle that faces it, in metres across and
    up from its middle; far outside where they go the other way."""
    at = torch.tensor(middle, dtype=torch.float64)
    axis = at / at.norm()
    up = torch.tensor([0.0, 0.0, -1.0] if abs(axis[1]) > 0.8 else [0.0, 1.0, 0.0]).double()
    across = torch.nn.functional.normalize(torch.linalg.cross(axis, up), dim=0)
    up = torch.linalg.cross(across, axis)
    rays = towards.flatten(1)
    place, reach, _ = on_rectangle(torch.zeros_like(rays[:, :1]), rays, at, across, up)
    x, y = torch.where(reach > 0, place, 1e3 * max(wide, high)).view(2, *towards.shape[1:])
    return x, y
