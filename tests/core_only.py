"""Run by test_packages.py: the library and the command where no extra is installed.

Arguments: a folder, and the modules that are refused. Writes what happened as JSON to stdout.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import warnings
from pathlib import Path
from typing import Any


class Refuses:
    """An import hook that says of some modules that they are not installed."""

    def __init__(self, modules: set[str]) -> None:
        self.modules = modules

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        if name.partition(".")[0] in self.modules:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def raden(*arguments: str) -> dict[str, Any]:
    """The command in this process: its exit code, and what it says on stderr."""
    from raden_torch.cli import main

    said, sys.argv = io.StringIO(), ["raden", *arguments]
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            main()
        except SystemExit as end:
            return {"code": end.code or 0, "stderr": said.getvalue()}
    return {"code": 0, "stderr": said.getvalue()}


def fitted(folder: Path) -> dict[str, float]:
    """The main job; 0.0 where what was read back is what was written."""
    import torch

    import raden_torch as rt

    rt.simulate_specimen("yakogai", step_deg=10, noise=0.01).save(folder / "shell.csv")
    shell = rt.load_measurement(folder / "shell.csv")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = rt.fit(shell, interpolation="trilinear").model
    rt.save_model(model, folder / "shell.safetensors")
    loaded = rt.load_model(folder / "shell.safetensors")
    normal = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    a, r = torch.deg2rad(torch.tensor(20.0)), torch.deg2rad(torch.tensor(30.0))
    light = (float(-a.sin()), 0.0, float(a.cos()))
    view = torch.stack([r.sin(), torch.zeros(()), r.cos()]).view(1, 3, 1, 1)
    image = rt.shade(loaded, rt.GBuffer(normal, view), rt.DirectionalLight(light))
    row = (shell.angles_deg == (20.0, 30.0, 0.0)).all(axis=1)
    expected = (
        shell.as_rgb().values[row][0] / 100 * float(a.cos())
    )  # under the default irradiance, π
    fit_form = loaded.fit_form(*(x.view(1, 1, 1) for x in (a, r, torch.zeros(())))).flatten()
    fit_form = fit_form * torch.pi * a.cos()
    return {
        "fit form": float((fit_form - torch.as_tensor(expected)).abs().max() / expected.max()),
        "shade": float((image.flatten() - torch.as_tensor(expected)).abs().max() / expected.max()),
        "read back": float((loaded.table.values - model.table.values).abs().max()),
    }


def main() -> None:
    folder, modules = Path(sys.argv[1]), set(sys.argv[2:])
    commands = json.load(sys.stdin)
    sys.meta_path.insert(0, Refuses(modules))
    done = {"errors": fitted(folder), "commands": [raden(*command) for command in commands]}
    done["imported"] = sorted(modules & {name.partition(".")[0] for name in sys.modules})
    done["file"] = sys.modules["raden_torch"].__file__
    json.dump(done, sys.stdout)


if __name__ == "__main__":
    main()
