"""Parameters in the library's messages become options of the running command."""

import subprocess
import sys
from pathlib import Path

import pytest

import raden_torch as rt
from raden_torch.cli import app
from raden_torch.cli.option_names import options_of, with_options


@pytest.mark.parametrize(
    ("words", "message", "shown"),
    [
        (["fit", "a.csv"], 'else `assume="isotropic"`', "else --assume isotropic"),
        (["fit", "a.csv"], "goes with `readings`", "goes with `readings`"),
        (["scan"], "`step_deg` goes with `adaptive`", "--step goes with --adaptive"),
        (["capture", "brdf", "a.png"], "continue: `go_on`", "continue: --go-on"),
        (["scan"], "see `raden info A B`", "see `raden info A B`"),
        ([], "`assume`", "`assume`"),
    ],
)
def test_options_stand_for_parameters(words: list[str], message: str, shown: str) -> None:
    assert with_options(message, options_of(app, words)) == shown


def test_the_command_line_names_its_option(tmp_path: Path) -> None:
    plane = [(i, r, 0) for i in (10, 20, 30) for r in (-20, 0, 20)]
    rt.simulate_specimen("akoya", geometries_deg=plane).save(tmp_path / "plane.csv")
    done = subprocess.run(
        [sys.executable, "-m", "raden_torch.cli", "fit", "plane.csv", "-o", "m.safetensors"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert "--assume isotropic derives the rest" in done.stderr
    assert "`" not in done.stderr
