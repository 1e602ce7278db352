"""From photographs back: normals where the shell is known, and the shell where the shape is known.

Both are found by Adam through `shade`, whose gradients the fused kernels compute, with a loss of
kornia's. The photographs are rendered, with 1 % noise. What is left is told in degrees, and for the
shell in photographs under lamps that it was not learnt from. Writes a picture to
benchmarks/results/inverse_rendering.png.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import kornia
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable

VIEW = (0.0, 0.0, 1.0)
NOISE = 0.01
"""Of the photographs' 99 % quantile."""


def lamps(count: int, turn: float = 0.0) -> Tensor:
    """Directions on rings 15, 35 and 55° from the viewer, `[count, 3]`."""
    k = torch.arange(count)
    theta = torch.deg2rad(torch.tensor([15.0, 35.0, 55.0]))[k % 3]
    phi = 2 * math.pi * (k * 0.618 + turn)
    return torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], dim=1)


def bumps(size: int) -> Tensor:
    """Normals of a wavy plate, up to 35° from the viewer."""
    y, x = torch.meshgrid(*2 * [torch.linspace(-1, 1, size)], indexing="ij")
    slopes = 0.5 * torch.cos(5 * x + y), 0.5 * torch.sin(4 * y - x) * torch.cos(2 * x)
    return torch.nn.functional.normalize(torch.stack([*slopes, torch.ones_like(x)])[None], dim=1)


def sphere(size: int) -> tuple[Tensor, Tensor]:
    """Normals and mask of a sphere that fills the picture."""
    y, x = torch.meshgrid(*2 * [torch.linspace(-1, 1, size)], indexing="ij")
    square = x * x + y * y
    normal = torch.stack([x, -y, (1 - square).clamp(min=1e-4).sqrt()])[None]
    return torch.nn.functional.normalize(normal, dim=1), (square < 0.95)[None, None].float()


def photographs(model: rt.RadenBrdf, normal: Tensor, at: Tensor, mask: Tensor | None) -> Tensor:
    """One image a lamp, `[lamps, 3, H, W]`."""
    scene = rt.GBuffer(normal.expand(len(at), -1, -1, -1), view=VIEW, mask=mask)
    return rt.shade(model, scene, rt.DirectionalLight(at))


def noisy(images: Tensor) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(images.shape, generator=generator).to(images.device)
    return images + NOISE * images.flatten().quantile(0.99) * noise


def compressed(images: Tensor) -> Tensor:
    """Highlights count as the eye sees them: a signed root."""
    return images.sign() * (images.abs() + 1e-4).sqrt()


def descend(parameters: list[Tensor], rate: float, steps: int, loss: object) -> None:
    """Adam, its rate falling to a hundredth along a cosine."""
    adam = torch.optim.Adam(parameters, lr=rate)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps, rate / 100)
    for _ in range(steps):
        adam.zero_grad()
        loss().backward()
        adam.step()
        falling.step()


def angle_deg(a: Tensor, b: Tensor) -> Tensor:
    cross = torch.linalg.cross(a, b, dim=1).norm(dim=1)
    return torch.rad2deg(torch.atan2(cross, (a * b).sum(1)))


def matt_normals(photos: Tensor, at: Tensor) -> Tensor:
    """Photometric stereo as if the shell were matt: the start."""
    grey = photos.mean(1)
    grey = grey.clamp(max=grey.median(0).values * 2)  # highlights
    normal = torch.linalg.lstsq(at, grey.flatten(1)).solution
    return torch.nn.functional.normalize(normal, dim=0).reshape(1, 3, *grey.shape[1:])


def find_normals(shell: rt.RadenBrdf, size: int, steps: int) -> tuple[Tensor, Tensor, Tensor]:
    """Truth, start and result of the normals."""
    truth = bumps(size).to(shell.table.values.device)
    lights = lamps(20)
    with torch.no_grad():
        photos = noisy(photographs(shell, truth, lights, None))
        seen = compressed(photos)
    guess = matt_normals(photos, lights.to(photos.device))
    slopes = (guess[:, :2] / guess[:, 2:].clamp(min=0.3)).requires_grad_()

    def normal() -> Tensor:
        return torch.nn.functional.normalize(
            torch.cat([slopes, torch.ones_like(slopes[:, :1])], 1), dim=1
        )

    def loss() -> Tensor:
        made = compressed(photographs(shell, normal(), lights, None))
        far = kornia.losses.charbonnier_loss(made, seen, reduction="mean")
        return far + 1e-3 * kornia.losses.total_variation(slopes, reduction="mean").mean()

    start = normal().detach()
    descend([slopes], 0.05, steps, loss)
    return truth, start, normal().detach()


def find_shell(shell: rt.RadenBrdf, size: int, steps: int) -> tuple[Tensor, Tensor, Tensor]:
    """Photographs under other lamps: of the shell, of the grey start, and of the shell found."""
    device = shell.table.values.device
    normal, mask = (m.to(device) for m in sphere(size))
    lights, others = lamps(20), lamps(6, turn=0.31)
    values = torch.full((15, 29, 29, 3), 0.1, device=device)
    grey = CosineDiffuse(torch.full((3,), 0.05), torch.ones(3)).to(device)
    found = rt.RadenBrdf(grey, ReflectanceTable(values, (0.0, -70.0, -70.0), (5.0, 5.0, 5.0)))
    with torch.no_grad():
        seen = compressed(noisy(photographs(shell, normal, lights, mask)))
        truth, start = (photographs(m, normal, others, mask) for m in (shell, found))

    def loss() -> Tensor:
        made = compressed(photographs(found, normal, lights, mask))
        far = kornia.losses.charbonnier_loss(made, seen * mask, reduction="mean")
        table = found.table.values
        rough = sum(table.diff(n=2, dim=k).square().mean() for k in range(3))
        return far + 0.02 * rough

    descend([found.table.values, *found.diffuse.parameters()], 0.02, steps, loss)
    with torch.no_grad():
        return truth, start, photographs(found, normal, others, mask)


def picture(normals: tuple[Tensor, ...], shells: tuple[Tensor, ...], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 9), layout="constrained")
    axes = figure.subplots(3, 3)
    for ax, m, name in zip(axes[0], normals, ("normals", "start", "found"), strict=True):
        ax.imshow((m[0].cpu().permute(1, 2, 0) + 1) / 2)
        ax.set_title(name)
    for row, k in zip(axes[1:], (1, 5), strict=True):
        for ax, m, name in zip(row, shells, ("shell, another lamp", "start", "found"), strict=True):
            ax.imshow(m[k].cpu().permute(1, 2, 0).clamp(0, 1) ** (1 / 2.2))
            ax.set_title(name)
    for ax in axes.flat:
        ax.set_axis_off()
    figure.savefig(path, dpi=90)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--size", type=int, default=32, help="rows and columns of a photograph")
    parser.add_argument(
        "--steps", type=int, default=120, help="for the normals; half for the shell"
    )
    options = parser.parse_args()
    shell = rt.fit(rt.simulate_specimen("yakogai")).model.to(options.device).requires_grad_(False)

    began = time.perf_counter()
    normals = find_normals(shell, options.size, options.steps)
    truth, start, found = normals
    for name, m in (("start", start), ("found", found)):
        off = angle_deg(m, truth).flatten()
        print(f"normals, {name}: median {off.median():.2f}°, 95 % {off.quantile(0.95):.2f}°")
    print(f"  {time.perf_counter() - began:.1f} s", flush=True)

    began = time.perf_counter()
    shells = find_shell(shell, options.size, options.steps // 2)
    peak = shells[0].flatten().quantile(0.99)
    for name, m in (("start", shells[1]), ("found", shells[2])):
        error = (m - shells[0]).square().mean().sqrt() / peak
        print(f"shell under other lamps, {name}: RMS {100 * error:.2f} % of the 99 % quantile")
    print(f"  {time.perf_counter() - began:.1f} s", flush=True)

    out = Path(__file__).with_name("results") / "inverse_rendering.png"
    out.parent.mkdir(exist_ok=True)
    picture(normals, shells, out)


if __name__ == "__main__":
    main()
