"""Run where a wheel is installed: the kernel is in it, and the main job gives the right value.

cibuildwheel runs it for every wheel (`test-command`); `check.py` in environments of its own.
With the argument `without-kernel` the package was built without a compiler.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch

import raden_torch as rt
from raden_torch.brdf.model import kernel


def shaded() -> torch.Tensor:
    """A perfect diffuser, saved and read back, under a lamp overhead and at 60° to its normal."""
    deg = np.mgrid[0:71:35, -70:71:35, -70:71:35].reshape(3, -1)
    white = rt.BrdfMeasurement(*deg, np.full((75, 3), 100.0), channels=("R", "G", "B"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "white.safetensors"
        rt.save_model(rt.fit(white).model, path)
        model = rt.load_model(path)
    up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    frame = rt.GBuffer(up.expand(1, 3, 16, 16), view=(0, 0, 1))
    lamps = (rt.DirectionalLight(towards) for towards in ((0, 0, 1), (3**0.5, 0, 1)))
    return torch.stack([rt.shade(model, frame, lamp) for lamp in lamps])


def main() -> None:
    wants_kernel = "without-kernel" not in sys.argv
    if (kernel.extension is not None) != wants_kernel:
        sys.exit(
            f"expected {'a' if wants_kernel else 'no'} kernel in the package, got the opposite"
        )
    overhead, aside = shaded().detach()
    worst = max(float((overhead - 1).abs().max()), float((aside - 0.5).abs().max()))
    if worst > 1e-5:
        sys.exit(f"expected a white diffuser within 1e-5 of 1 and 0.5, got {worst:.1e} beside it")
    said = subprocess.run(
        [sys.executable, "-m", "raden_torch.cli", "--version"], capture_output=True, text=True
    )
    if said.stdout.strip() != f"raden {version('raden_torch')}":
        sys.exit(f"expected the version, got {said.stdout!r} {said.stderr!r}")
    if rt.__version__ != version("raden_torch"):
        sys.exit(f"expected version {version('raden_torch')} in the package, got {rt.__version__}")
    print(
        f"{Path(rt.__file__).parent}: raden_torch {rt.__version__}, Python "
        f"{sys.version.split()[0]}, torch {torch.__version__}, numpy {np.__version__}, "
        f"{'with' if wants_kernel else 'without'} kernel: {worst:.1e} from the truth"
    )


main()
