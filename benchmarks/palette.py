"""What a palette costs: time of a frame against the number of materials, at equal covered pixels.

python benchmarks/palette.py [--out benchmarks/results]

A wavy plate of 1080p is cut into pieces of 47 x 54 pixels; each piece has one of K copies of a
simulated shell. The worst case is an index drawn for each pixel. All forms are timed by turns on
one thread, in processor time, the least of several. Writes palette.json and palette.png.
"""

from __future__ import annotations

import argparse
import copy
import json
from collections.abc import Callable
from pathlib import Path

import torch
from in_turn import least_cpu_ms
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.model import simd

COUNTS = (1, 2, 4, 8, 16, 32)
HEIGHT, WIDTH = 1080, 1920
CASES = (("pieces", 1.0), ("pieces", 0.2), ("pixels", 1.0))
"""What has its own material, and the share that is covered."""
LAMPS = (1, 8)


def scene() -> tuple[Tensor, Tensor]:
    """Normals `[1, 3, H, W]` of a wavy plate, and the number of each pixel's piece `[H, W]`."""
    at = torch.linspace(-1, 1, HEIGHT), torch.linspace(-1.7, 1.7, WIDTH)
    y, x = torch.meshgrid(*at, indexing="ij")
    normal = torch.stack([0.2 * torch.sin(9 * x), 0.2 * torch.cos(7 * y), torch.ones_like(x)])
    return normal[None], ((x * 12).floor() * 7 + (y * 10).floor() * 13).long()


def forms(
    model: rt.RadenBrdf, of_each: str, share: float, lamps: int
) -> dict[str, Callable[[], Tensor]]:
    """The frame with the model alone, and with a palette of each size."""
    normal, piece = scene()
    mask = ((piece % 5) < 5 * share).float()[None, None]
    lights = [rt.DirectionalLight((1, k, 2), 1.0) for k in range(lamps)]
    made: dict[str, Callable[[], Tensor]] = {}
    drawn = torch.randint(0, 2**20, piece.shape, generator=torch.Generator().manual_seed(0))
    chosen = drawn if of_each == "pixels" else piece // 5

    def frame(material: rt.RadenBrdf | Palette, index: Tensor | None) -> Callable[[], Tensor]:
        gbuffer = rt.GBuffer(normal, (0, 0, 1), mask=mask, material=index)
        return lambda: rt.shade(material, gbuffer, lights)

    made["alone"] = frame(model, None)
    for count in COUNTS:
        palette = Palette([copy.deepcopy(model) for _ in range(count)])
        made[str(count)] = frame(palette, (chosen % count)[None, None])
    return made


def draw(rows: list[dict[str, object]], path: Path) -> None:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for row in rows:
        times = row["ms"]
        assert isinstance(times, dict)
        line = "o--" if row["own"] == "pixels" else "o-"
        axes.plot(COUNTS, [times[str(k)] / times["1"] for k in COUNTS], line, label=described(row))
    axes.axhline(1.5, color="0.6", linewidth=0.8)
    axes.set(xscale="log", xlabel="materials in the palette", ylabel="time over that of one")
    axes.set_xticks(COUNTS, COUNTS)
    axes.minorticks_off()
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=100)


def described(row: dict[str, object]) -> str:
    lamps = "1 lamp" if row["lamps"] == 1 else f"{row['lamps']} lamps"
    if row["own"] == "pixels":
        return f"an index drawn for each pixel, {lamps}"
    return f"{100 * float(str(row['covered'])):.0f} % covered, in pieces, {lamps}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--runs", type=int, default=15)
    options = parser.parse_args()
    model = rt.fit(rt.simulate_specimen("yakogai")).model.requires_grad_(False)
    torch.set_num_threads(1)
    rows: list[dict[str, object]] = []
    for of_each, share in CASES:
        for lamps in LAMPS:
            ms = least_cpu_ms(forms(model, of_each, share, lamps), options.runs)
            rows.append({"own": of_each, "covered": share, "lamps": lamps, "ms": ms})
            ratios = ", ".join(f"{k}: {ms[str(k)] / ms['1']:.2f}" for k in COUNTS)
            print(
                f"{described(rows[-1])}: {ratios}; one over the model alone "
                f"{ms['1'] / ms['alone']:.2f}"
            )
    options.out.mkdir(parents=True, exist_ok=True)
    about = {"kernel": simd.level(), "threads": torch.get_num_threads(), "rows": rows}
    (options.out / "palette.json").write_text(json.dumps(about, indent=1, default=str))
    draw(rows, options.out / "palette.png")


if __name__ == "__main__":
    main()
