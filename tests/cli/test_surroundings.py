"""The `raden` command in terminals, shells and folders that are not as usual."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse

TEXT = {"encoding": "utf-8", "errors": "surrogateescape"}


def raden(
    *arguments: object, cwd: Path | None = None, **options: object
) -> subprocess.CompletedProcess[str]:
    environment = os.environ | options.pop("env", {})  # type: ignore[arg-type]
    return subprocess.run(
        [sys.executable, "-m", "raden_torch", *map(str, arguments)],
        stderr=subprocess.PIPE,
        cwd=cwd,
        env=environment,
        timeout=120,
        **({"stdout": subprocess.PIPE} | TEXT | options),  # type: ignore[call-overload]
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a measurement and a model."""
    made = tmp_path_factory.mktemp("surroundings")
    rt.simulate_specimen("yakogai", step_deg=35.0).save(made / "shell.csv")
    import torch

    part = CosineDiffuse(torch.full((3,), 0.2), torch.ones(3))
    rt.save_model(rt.RadenBrdf(part, None), made / "shell.safetensors")
    return made


@pytest.mark.parametrize(
    "environment",
    [
        {"PYTHONIOENCODING": "ascii"},
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    ],
    ids=["ascii", "C"],
)
def test_what_a_terminal_cannot_show_is_escaped(folder: Path, environment: dict[str, str]) -> None:
    done = raden("info", folder / "shell.csv", env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert r"incidence: 0\u202670 deg by 35" in done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="file names are bytes on Linux alone")
def test_a_name_that_is_no_text_is_told_escaped(folder: Path) -> None:
    name = b"shell\xff.csv"
    (folder / os.fsdecode(name)).write_bytes((folder / "shell.csv").read_bytes())
    arguments = ("merge", os.fsdecode(name), "-o", "merged.csv")
    done = raden(*arguments, cwd=folder, env={"PYTHONIOENCODING": "utf-8:strict"})
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    done = raden("info", os.fsdecode(name), cwd=folder, env={"PYTHONIOENCODING": "utf-8:strict"})
    assert done.stdout.startswith("measurement of yakogai")


def test_warnings_as_errors_are_one_line(folder: Path) -> None:
    arguments = ("render", "shell.safetensors", "--light", "0,0,-1", "--size", "16", "-o", "x.png")
    done = raden(*arguments, cwd=folder, env={"PYTHONWARNINGS": "error"})
    assert done.returncode == 2
    assert done.stderr.startswith("raden: stopped at a warning: the picture is black")
    assert done.stderr.count("\n") == 1


@pytest.mark.skipif(sys.platform != "linux", reason="RLIMIT_AS and /dev/full are Linux's")
def test_too_little_memory_and_a_full_output_are_one_line(folder: Path) -> None:
    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (3_000_000_000, 3_000_000_000))

    arguments = ("render", "shell.safetensors", "--size", "16000", "--samples", "1", "-o", "x.png")
    done = raden(*arguments, cwd=folder, preexec_fn=limited)
    assert (done.returncode, done.stderr.split(";")[0]) == (2, "raden: not enough memory")
    with open("/dev/full", "w") as full:
        done = raden("info", "shell.csv", cwd=folder, stdout=full)
    assert (done.returncode, done.stderr) == (2, "raden: output: No space left on device\n")


@pytest.mark.parametrize("words", [[], ["capture", "normals"]])
def test_help_has_its_short_name(words: list[str]) -> None:
    assert raden(*words, "-h").stdout == raden(*words, "--help").stdout != ""
