"""A shell's table, and its gains, from photographs of a sphere of it, by descent through `shade`.

    python recover_shell.py --out shell.png
    python recover_shell.py --device cuda --size 256

The shape is known, the shell is not: Adam moves the values of a table that is grey at the start
until the rendered pictures are the photographs. The error is told at the nodes of the table that
the photographs saw, and in photographs under lamps that it was not learnt from. Then only the two
gains of eq. (2) are unknown, and found the same way.
"""

from __future__ import annotations

import copy
import sys
from pathlib import Path

import torch
from photographed_shell import (
    VIEW,
    Stress,
    descend,
    difference,
    lamps,
    parser,
    photographs,
    render,
    shell_of,
    shown,
)
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable

FIRST_DEG, STEP_DEG = (0.0, -70.0, -70.0), 5.0
PIECES = ((1,) * 14, (1,) * 17 + (2,) * 8 + (1,) * 17, (1,) * 11 + (2,) * 6 + (1,) * 11)
"""Into how many a cell of 5° is cut along incidence, receiving − incidence, and tilt: the mirror's
ridge runs along the first, and is narrow across the others."""
SMOOTH = 2e-3
"""Weight of the second differences along the table's axes."""
SEEN = 3.0
"""Pixels, in trilinear weights, that make a node a seen one."""
GAINS = (0.6, 1.4)


def sphere(size: int) -> tuple[Tensor, Tensor]:
    """Normals and mask of a sphere that fills the picture."""
    y, x = torch.meshgrid(torch.linspace(1, -1, size), torch.linspace(-1, 1, size), indexing="ij")
    square = x * x + y * y
    normal = torch.stack([x, y, (1 - square).clamp(min=1e-4).sqrt()])[None]
    return torch.nn.functional.normalize(normal), (square < 0.95)[None, None].float()


def table_of(value: float, channels: int) -> ReflectanceTable:
    values = torch.full((*(1 + sum(cuts) for cuts in PIECES), channels), value)
    return ReflectanceTable(values, FIRST_DEG, (STEP_DEG,) * 3, PIECES)


class Photographed(torch.nn.Module):
    """Photographs of a model as a module, so that `functional_call` may give it other values."""

    def __init__(self, model: rt.RadenBrdf) -> None:
        super().__init__()
        self.model = model

    def forward(self, normal: Tensor, at: Tensor, mask: Tensor) -> Tensor:
        return render(self.model, normal, at, mask)


def grey(device: str) -> rt.RadenBrdf:
    """The start: one f_r everywhere."""
    table = table_of(0.1, 3)
    part = CosineDiffuse(torch.full((3,), 0.1), torch.ones(3))
    return rt.RadenBrdf(part, table).to(device).requires_grad_(False)


def recover(
    model: rt.RadenBrdf, photos: Tensor, scene: tuple[Tensor, Tensor], at: Tensor, steps: int
) -> float:
    """Writes the table of `model`; seconds. What moves is its logarithm: f_r spans two decades, and
    Adam's steps are then in proportion."""
    normal, mask = scene
    assert model.table is not None
    logarithm = model.table.values.log().requires_grad_()
    photographed = Photographed(model)

    def loss() -> Tensor:
        values = {"model.table.values": logarithm.exp()}
        made = torch.func.functional_call(photographed, values, (normal, at, mask))
        rough = sum(logarithm.diff(n=2, dim=k).square().mean() for k in range(3))
        return difference(made, photos * mask) + SMOOTH * rough

    seconds = descend([logarithm], 0.1, steps, loss)
    with torch.no_grad():
        model.table.values.copy_(logarithm.exp())
    return seconds


def recover_gains(
    shell: rt.RadenBrdf, photos: Tensor, scene: tuple[Tensor, Tensor], at: Tensor, steps: int
) -> Tensor:
    """I_d and I_s of eq. (2), from 1 and 1."""
    normal, mask = scene
    own = copy.deepcopy(shell)
    gains = torch.ones(2, device=normal.device, requires_grad=True)

    def loss() -> Tensor:
        own.diffuse_gain, own.specular_gain = gains.unbind()
        return difference(render(own, normal, at, mask), photos * mask)

    descend([gains], 0.1, steps, loss)
    return gains.detach().cpu()


def pixels_per_node(scene: tuple[Tensor, Tensor], at: Tensor) -> Tensor:
    """The trilinear weights of all pixels, lit and seen, at each node of the table."""
    normal, mask = (m.cpu() for m in scene)
    to, view = at[:, :, None, None], torch.tensor(VIEW).view(1, 3, 1, 1)
    angles = rt.raden_angles(normal, to, view)
    lit = ((normal * to).sum(1, keepdim=True) > 0) & (mask > 0)
    table = table_of(0.0, 1)
    f, weight = table(*angles)
    (f * (weight == 1) * lit).sum().backward()
    assert table.values.grad is not None
    return table.values.grad[..., 0]


def node_angles() -> tuple[Tensor, ...]:
    """Incidence, receiving and tilt of the table's nodes in degrees, flattened."""
    cells = [
        torch.cat([torch.zeros(1), (1 / torch.tensor(cuts).repeat_interleave(torch.tensor(cuts)))])
        for cuts in PIECES
    ]
    a, across, t = torch.meshgrid(*(STEP_DEG * x.cumsum(0) for x in cells), indexing="ij")
    r = a + across - STEP_DEG * len(PIECES[0]) - 70
    return a.flatten(), r.flatten(), t.flatten() - 70


def node_errors(found: rt.RadenBrdf, truth: rt.RadenBrdf, seen: Tensor) -> Tensor:
    """Relative error of f_r at the seen nodes: of three channels, over the true mean of them."""
    degrees = node_angles()
    kept = seen.flatten() & (degrees[1].abs() <= 70)
    angles = [torch.deg2rad(x[kept]).view(1, -1, 1) for x in degrees]
    with torch.no_grad():
        a, b = (copy.deepcopy(m).cpu().fit_form(*angles)[..., 0] for m in (found, truth))
    return (a - b).abs().mean(0) / b.mean(0).abs().clamp(min=1e-3)


def picture(rows: dict[str, Tensor], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5.6), layout="constrained")
    columns = len(next(iter(rows.values())))
    for k, (name, images) in enumerate(rows.items()):
        for j, image in enumerate(images):
            ax = figure.add_subplot(len(rows), columns, k * columns + j + 1)
            ax.imshow(shown(image))
            ax.set(xticks=[], yticks=[])
            if j == 0:
                ax.set_ylabel(name)
    figure.savefig(path, dpi=80)


def main(arguments: list[str] | None = None) -> dict[str, float]:
    options = parser(__doc__, size=64, lamps=48, steps=150).parse_args(arguments)
    shell = shell_of(options)
    normal, mask = (m.to(options.device) for m in sphere(options.size))
    scene, stress = (normal, mask), Stress(options.noise, options.lamps_off)
    at, others = lamps(options.lamps, 4, 110), lamps(6, 10, 80, turn=0.31)
    photos = photographs(shell, normal, at, stress, mask)
    found = grey(options.device)
    seen = pixels_per_node(scene, at) >= SEEN
    figures = {"nodes seen": float(seen.float().mean())}
    print(f"{100 * figures['nodes seen']:.0f} % of the table's nodes are seen by {SEEN:g} pixels")

    def say(name: str) -> Tensor:
        """Errors as they are now; the pictures under other lamps."""
        with torch.no_grad():
            true, made = (render(m, normal, others, mask) for m in (shell, found))
        elsewhere = float((made - true).square().mean().sqrt() / true.flatten().quantile(0.99))
        off = node_errors(found, shell, seen)
        figures.update({
            f"{name} mean": float(off.mean()), f"{name} median": float(off.median()),
            f"{name} 95 %": float(off.quantile(0.95)), f"{name} under other lamps": elsewhere,
        })  # fmt: skip
        print(f"{name}: f_r at the seen nodes: median {100 * off.median():.1f} %, mean "
              f"{100 * off.mean():.1f} %, 95 % {100 * off.quantile(0.95):.1f} %; RMS under other "
              f"lamps {100 * elsewhere:.1f} % of the 99 % quantile", flush=True)  # fmt: skip
        return made

    start = say("start")
    figures["seconds"] = recover(found, photos, scene, at, options.steps)
    made = say("found")
    print(f"{options.steps} steps, {figures['seconds']:.1f} s")
    brighter = copy.deepcopy(shell)
    brighter.diffuse_gain, brighter.specular_gain = GAINS
    photos = photographs(brighter, normal, at, stress, mask)
    gains = recover_gains(shell, photos, scene, at, max(options.steps // 3, 40))
    figures["gains"] = float((gains / torch.tensor(GAINS) - 1).abs().max())
    print(f"gains: {gains[0]:.3f}, {gains[1]:.3f}; the truth is {GAINS[0]}, {GAINS[1]}")
    if options.out is not None:
        with torch.no_grad():
            true = render(shell, normal, others, mask)
        picture(
            {
                "the shell": true,
                "start": start,
                "found": made,
                "5 × error": 5 * (made - true).abs(),
            },
            options.out,
        )
    return figures


if __name__ == "__main__":
    main(sys.argv[1:])
