"""docs/pictures/stereo.jpg: a simulated plate of awabi, its normals by a matt law and by the model.

python docs/pictures/stereo.py
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import raden_torch as rt

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))
from stereo import off_deg, photographed, solved  # noqa: E402


def main() -> None:
    with TemporaryDirectory() as made:
        folder = Path(made)
        model = folder / "awabi.safetensors"
        rt.save_model(rt.fit(rt.simulate_specimen("awabi")).model, model)
        true = photographed(folder, "awabi", "plate", 12, 16, 96)
        photos, mask = sorted(folder.glob("photo*.png")), folder / "mask.png"
        figure = Figure(figsize=(10, 5.4), dpi=110, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, 4)
        maps = {"true normals": true}
        for method in ("robust", "alternating", "model"):
            found = solved(folder, photos, mask, method, "linear", model).normal
            maps[method] = found[0].movedim(0, -1).numpy()
            everywhere = np.ones(true.shape[:2], bool)
            off = off_deg(found, true, everywhere).reshape(everywhere.shape)
            ax = axes[1, len(maps) - 1]
            shown = ax.imshow(off, vmin=0, vmax=15, cmap="viridis")
            ax.set_title(f"error, median {np.median(off):.1f}°", fontsize=9)
        for ax, (name, normal) in zip(axes[0], maps.items(), strict=True):
            ax.imshow((normal + 1) / 2)
            ax.set_title(name, fontsize=9)
        figure.colorbar(shown, ax=axes[1, 3], label="degrees")
        from raden_torch.capture.photo.photograph import read_linear

        axes[1, 0].imshow(read_linear(photos[0], coded="linear").linear.clip(0, 1) ** (1 / 2.2))
        axes[1, 0].set_title("one of 12 photographs (simulated)", fontsize=9)
        for ax in axes.flat:
            ax.set_axis_off()
        figure.savefig(ROOT / "docs/pictures/stereo.jpg")


if __name__ == "__main__":
    main()
