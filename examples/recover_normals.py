"""Normals from photographs of a shell that is known, by gradient descent through `shade`.

    python recover_normals.py --out normals.png
    python recover_normals.py --device cuda --size 512

A carved plate is photographed under several lamps. The start is photometric stereo, which takes
the shell for a matt surface. Adam then moves the slopes until the rendered pictures are the
photographs.
"""

from __future__ import annotations

import sys
from pathlib import Path

import kornia
import torch
from photographed_shell import (
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

SMOOTH = 1e-2
"""Weight of the slopes' total variation."""


def carved(size: int) -> Tensor:
    """Normals `[1, 3, size, size]` of a flower in relief, up to some 35° from the viewer."""
    y, x = torch.meshgrid(torch.linspace(1, -1, size), torch.linspace(-1, 1, size), indexing="ij")
    r, phi = torch.hypot(x, y), torch.atan2(y, x)
    petals = torch.cos(6 * phi) * (1 - torch.exp(-((r / 0.35) ** 4)))
    height = 0.09 * torch.cos(7 * r) + 0.07 * petals * torch.exp(-((r / 0.85) ** 6))
    step = 2 / (size - 1)
    down, across = torch.gradient(height, spacing=step)
    return torch.nn.functional.normalize(torch.stack([-across, down, torch.ones_like(x)])[None])


def matt_normals(photos: Tensor, at: Tensor) -> Tensor:
    """Photometric stereo as if the shell were matt, its highlights cut off."""
    grey = photos.mean(1)
    grey = grey.clamp(max=grey.median(0).values * 2)
    normal = torch.linalg.lstsq(at.to(grey), grey.flatten(1)).solution
    return torch.nn.functional.normalize(normal, dim=0).reshape(1, 3, *grey.shape[1:])


def normal_of(slopes: Tensor) -> Tensor:
    """`[1, 2, H, W]` → unit normals."""
    return torch.nn.functional.normalize(torch.cat([slopes, torch.ones_like(slopes[:, :1])], 1))


def recover(
    shell: rt.RadenBrdf, photos: Tensor, at: Tensor, steps: int, smooth: float = SMOOTH
) -> tuple[Tensor, Tensor, float]:
    """Normals at the start, normals found, and seconds."""
    start = matt_normals(photos, at)
    slopes = (start[:, :2] / start[:, 2:].clamp(min=0.3)).requires_grad_()

    def loss() -> Tensor:
        rough = kornia.losses.total_variation(slopes, reduction="mean").mean()
        return difference(render(shell, normal_of(slopes), at), photos) + smooth * rough

    seconds = descend([slopes], 0.05, steps, loss)
    return start, normal_of(slopes).detach(), seconds


def angle_deg(a: Tensor, b: Tensor) -> Tensor:
    """Between unit vectors `[1, 3, H, W]` → `[H, W]`."""
    across = torch.linalg.cross(a, b, dim=1).norm(dim=1)
    return torch.rad2deg(torch.atan2(across, (a * b).sum(1)))[0]


def picture(images: dict[str, Tensor], error: Tensor, photo: Tensor, path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 2.9), layout="constrained")
    axes = figure.subplots(1, 5)
    axes[0].imshow(shown(photo))
    axes[0].set_title("a photograph")
    for ax, (name, normal) in zip(axes[1:], images.items(), strict=False):
        ax.imshow(((normal[0].cpu().movedim(0, -1) + 1) / 2).numpy())
        ax.set_title(name)
    drawn = axes[4].imshow(error.cpu().numpy(), vmin=0, vmax=3, cmap="magma")
    axes[4].set_title("error of what was found")
    figure.colorbar(drawn, ax=axes[4], label="degrees")
    for ax in axes:
        ax.set_axis_off()
    figure.savefig(path, dpi=90)


def main(arguments: list[str] | None = None) -> dict[str, float]:
    options = parser(__doc__, size=64, lamps=20, steps=120).parse_args(arguments)
    shell = shell_of(options)
    truth = carved(options.size).to(options.device)
    at = lamps(options.lamps, 10, 60)
    photos = photographs(shell, truth, at, Stress(options.noise, options.lamps_off))
    start, found, seconds = recover(shell, photos, at, options.steps)
    figures = {"seconds": seconds}
    for name, normal in (("start", start), ("found", found)):
        off = angle_deg(normal, truth)
        figures |= {f"{name} mean": float(off.mean()), f"{name} 95 %": float(off.quantile(0.95))}
        print(f"{name}: mean {off.mean():.2f}°, median {off.median():.2f}°, 95 % "
              f"{off.quantile(0.95):.2f}°")  # fmt: skip
    print(f"{options.steps} steps, {seconds:.1f} s")
    if options.out is not None:
        images = {"normals": truth, "start: as if matt": start, "found": found}
        picture(images, angle_deg(found, truth), photos[1], options.out)
    return figures


if __name__ == "__main__":
    main(sys.argv[1:])
