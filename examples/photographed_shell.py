"""What the two examples of inverse rendering share: photographs of a shell, and the way back.

The photographs are rendered, with noise and under lamps that lie a little off from where they are
said to be, so that what is found can be compared with the truth.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import kornia
import numpy as np
import torch
from torch import Tensor

import raden_torch as rt

VIEW = (0.0, 0.0, 1.0)
FLOOR = 0.03
"""Of radiance, where a white sheet that faces a lamp has 1."""


@dataclass(frozen=True)
class Stress:
    """What real photographs have: noise, as a share of their 99 % quantile, and lamps off."""

    noise: float
    lamps_off_deg: float


def parser(what: str | None, **defaults: int) -> argparse.ArgumentParser:
    """The options that both examples take."""
    p = argparse.ArgumentParser(
        description=what, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("--shell", type=Path, help="a model of raden fit; default: a simulated yakogai")
    p.add_argument("--device", default="cpu", help="cuda: the GPU")
    p.add_argument("--size", type=int, default=defaults["size"], help="rows of a photograph")
    p.add_argument("--lamps", type=int, default=defaults["lamps"], help="one photograph each")
    p.add_argument("--steps", type=int, default=defaults["steps"], help="of Adam")
    p.add_argument("--noise", type=float, default=0.01, help="of the photographs' 99 %% quantile")
    p.add_argument("--lamps-off", type=float, default=0.0, help="degrees, each in its direction")
    p.add_argument("--out", type=Path, help="the picture, PNG")
    return p


def shell_of(options: argparse.Namespace) -> rt.RadenBrdf:
    if options.shell is not None:
        model = rt.load_model(options.shell)
    else:
        model = rt.fit(rt.simulate_specimen("yakogai")).model
    return model.to(options.device).requires_grad_(False)


def lamps(count: int, least_deg: float, most_deg: float, turn: float = 0.0) -> Tensor:
    """Directions on a spiral around the viewer, `[count, 3]`."""
    k = torch.arange(count)
    theta = torch.deg2rad(least_deg + (most_deg - least_deg) * (k + 0.5) / count)
    phi = 2 * math.pi * (k * 0.618 + turn)
    return torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], dim=1)


def render(model: rt.RadenBrdf, normal: Tensor, at: Tensor, mask: Tensor | None = None) -> Tensor:
    """One image a lamp, `[lamps, 3, H, W]`."""
    scene = rt.GBuffer(normal.expand(len(at), -1, -1, -1), view=VIEW, mask=mask)
    return rt.shade(model, scene, rt.DirectionalLight(at))


@torch.no_grad()
def photographs(
    model: rt.RadenBrdf, normal: Tensor, at: Tensor, stress: Stress, mask: Tensor | None = None
) -> Tensor:
    """As `render`, with noise, and under lamps turned from `at` by so many degrees."""
    generator = torch.Generator().manual_seed(0)
    aside = torch.linalg.cross(at, torch.randn(at.shape, generator=generator))
    off = math.tan(math.radians(stress.lamps_off_deg))
    true_at = torch.nn.functional.normalize(at + off * torch.nn.functional.normalize(aside))
    images = render(model, normal, true_at, mask)
    noise = torch.randn(images.shape, generator=generator).to(images.device)
    return images + stress.noise * images.flatten().quantile(0.99) * noise


def difference(rendered: Tensor, photographed: Tensor) -> Tensor:
    """Charbonnier's loss of logarithms, as the eye compares: a highlight in the wrong place pulls,
    but does not drown what is dim. `FLOOR` keeps noise in the dark from counting."""
    logs = ((x.clamp(min=0) + FLOOR).log() for x in (rendered, photographed))
    return kornia.losses.charbonnier_loss(*logs, reduction="mean")


def descend(
    parameters: Sequence[Tensor], rate: float, steps: int, loss: Callable[[], Tensor]
) -> float:
    """Adam, its rate falling to a hundredth along a cosine; seconds taken."""
    began = time.perf_counter()
    adam = torch.optim.Adam(parameters, lr=rate)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps, rate / 100)
    for _ in range(steps):
        adam.zero_grad()
        loss().backward()
        adam.step()
        falling.step()
    if parameters[0].is_cuda:
        torch.cuda.synchronize()
    return time.perf_counter() - began


def shown(image: Tensor) -> np.ndarray:
    """`[3, H, W]` scene-linear → `[H, W, 3]` for matplotlib."""
    return (image.detach().cpu().movedim(0, -1).clamp(0, 1) ** (1 / 2.2)).numpy()
