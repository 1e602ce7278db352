"""What every command has: --quiet, --verbose, --json where it reports, examples, completion."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

import raden_torch as rt
from raden_torch.cli.command_table import (
    _CAPTURE_COMMANDS,
    _CATALOGUE_COMMANDS,
    _COMMANDS,
    app,
)
from raden_torch.cli.json_output import plain

Command = Callable[..., subprocess.CompletedProcess[str]]

PAGE = Path(__file__).parents[2] / "docs/command_line.md"
EXAMPLES = [
    example
    for _, _, examples in (*_COMMANDS, *_CAPTURE_COMMANDS, *_CATALOGUE_COMMANDS)
    for example in examples.split("; ")
    if example.startswith("raden ")  # the rest says what it reads
]
NOT_RUN = ("bench", "demo", "scan", "capture", "catalogue")
"""Their examples take minutes, an instrument or photographs; tests of their own run these."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that the examples name."""
    path = tmp_path_factory.mktemp("examples")
    for name, seed in (("shell", 0), ("scan", 1), ("photographs", 2)):
        measured = rt.simulate_specimen("yakogai", step_deg=35.0, noise=0.02, seed=seed)
        measured.save(path / f"{name}.csv")
    model = rt.fit(rt.load_measurement(path / "shell.csv"), interpolation="trilinear").model
    rt.save_model(model, path / "shell.safetensors")
    cv2.imwrite(str(path / "box.png"), np.full((24, 32, 3), 128, np.uint8))
    cv2.imwrite(str(path / "n.png"), np.full((24, 32, 3), (255, 128, 128), np.uint8))
    cv2.imwrite(str(path / "m.png"), np.full((24, 32), 255, np.uint8))
    (path / "shells").mkdir()
    shutil.copy(path / "scan.csv", path / "shells/rim.csv")
    (path / "lights.csv").write_text('name,light\nleft.png,"-1,1,2"\nright.png,"1,1,2"\n')
    return path


def expanded(words: list[str], folder: Path) -> list[str]:
    """As a shell does: a pattern of files becomes their names."""
    named = [sorted(str(p.relative_to(folder)) for p in folder.glob(w)) for w in words]
    return [
        part
        for word, found in zip(words, named, strict=True)
        for part in (found if "*" in word else [word])
    ]


@pytest.mark.parametrize("example", EXAMPLES)
def test_every_example_can_be_read(example: str, tmp_path: Path) -> None:
    words = shlex.split(example)
    assert words[0] == "raden"
    command, given, _ = app.parse_args(words[1:])
    assert callable(command)
    assert given.arguments


@pytest.mark.slow
def test_the_examples_of_help_run(raden: Command, folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    mirror = [(angle, angle, 0.0) for angle in range(0, 71, 5)]  # what `analyse` looks at
    ran = [shlex.split(e)[1:] for e in EXAMPLES if e.split()[1] not in NOT_RUN]
    for words in ran:
        if "gold.binary" in words:
            shutil.copy(tmp_path / "shell.binary", tmp_path / "gold.binary")
        if words[0] == "analyse":
            rt.simulate_specimen("yakogai", geometries_deg=mirror).save(tmp_path / "shell.csv")
        words = expanded(words, tmp_path)
        done = raden(*words, cwd=tmp_path, warn="default")
        assert done.returncode == 0, (words, done.stderr)
        for word in words:  # what an example names is there afterwards
            assert "." not in word[1:] or "," in word or (tmp_path / word).exists() or word == "2.5"
        shutil.copy(folder / "shell.csv", tmp_path / "shell.csv")
    assert len(ran) >= 12


def test_quiet_leaves_out_all_but_warnings(raden: Command, folder: Path, tmp_path: Path) -> None:
    shell, out = folder / "shell.csv", tmp_path / "m.csv"
    said = raden("merge", shell, folder / "scan.csv", "-o", out)
    assert f"wrote {out}" in said.stdout
    for words in (("--quiet", "merge"), ("merge", "-q")):
        done = raden(*words, shell, folder / "scan.csv", "-o", out)
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    answer = raden("info", shell, "--quiet")
    assert "75 readings" in answer.stdout
    for named in ("-q", ""):  # what is written into a folder is no option
        done = raden("catalogue", "add", tmp_path / f"shells{named}", shell, *named.split())
        assert (done.returncode, done.stderr) == (0, "")
        assert (done.stdout == "") == bool(named)
    found = raden("catalogue", "find", tmp_path / "shells-q", "-q")
    assert "shell" in found.stdout
    as_json = raden("merge", shell, folder / "scan.csv", "-o", out, "-q", "--json")
    assert json.loads(as_json.stdout)["output"] == str(out)
    black = raden(
        *("render", folder / "shell.safetensors", "--light", "0,0,-1", "--size", "8"),
        *("-o", tmp_path / "a.png", "-q"),
        warn="default",
    )
    assert (black.returncode, black.stdout) == (0, "")
    assert black.stderr.startswith("raden: warning: the picture is black")


def test_verbose_says_steps_versions_and_where(raden: Command, folder: Path) -> None:
    done = raden("info", folder / "shell.csv", "--verbose")
    assert done.returncode == 0
    versions, step = done.stderr.splitlines()
    assert re.match(r"raden: raden_torch \S+, torch \S+, numpy \S+, Python 3", versions)
    assert re.fullmatch(r"raden: reading shell.csv: \d+\.\d\d s", step)
    failed = raden("--verbose", "info", folder / "none.csv")
    assert failed.returncode == 2
    assert "Traceback" in failed.stderr
    assert failed.stderr.splitlines()[-1].startswith("raden: ")
    assert "Traceback" not in raden("info", folder / "none.csv").stderr  # nothing is kept
    both = raden("info", "-q", "--verbose", folder / "shell.csv")
    assert (both.returncode, both.stdout) == (2, "")
    assert both.stderr == "raden: --quiet and --verbose contradict each other; give one of them\n"


def test_what_follows_two_hyphens_is_a_file(raden: Command, tmp_path: Path) -> None:
    done = raden("info", "--", "-q", cwd=tmp_path)
    assert done.stderr.startswith("raden: -q: expected a file that raden knows")


def test_json_holds_what_the_text_says(raden: Command, folder: Path, tmp_path: Path) -> None:
    def said(*words: object) -> dict[str, object]:
        done = raden(*words, "--json", warn="default")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    shell, scan, model = folder / "shell.csv", folder / "scan.csv", folder / "shell.safetensors"
    facts = said("info", shell)
    assert facts["kind"] == "a measurement"
    assert "75 readings, 75 valid; channels X, Y, Z; white D65, CIE 1931 2 deg" in facts["facts"]
    scored = said("info", model, "--against", shell)
    assert scored["score"]["readings"] == 75
    assert f"RMS {scored['score']['rms']:.5f}" in raden("info", model, "--against", shell).stdout
    compared = said("info", shell, scan)
    assert compared["agrees"] is True
    assert compared["comparison"]["regions"][-1]["name"] == "all"
    fitted = said("fit", shell, "--interpolation", "trilinear", "-o", tmp_path / "m.safetensors")
    assert fitted["reports"][0]["cells"] == 75
    assert fitted["names"] == []
    merged = said("merge", shell, scan, "-o", tmp_path / "m.csv")
    assert (merged["readings"], merged["shared"]) == (75, 75)
    assert any("threads" in line for line in said("info", "--system")["system"])


def test_json_has_no_nan_and_no_arrays() -> None:
    given = {"a": float("nan"), "b": (float("inf"), 1.5), "c": np.ones(3), "d": Path("x")}
    assert plain(given) == {"a": None, "b": [None, 1.5], "d": "x"}


def test_a_log_gets_no_bars(folder: Path, tmp_path: Path) -> None:
    """Rationale: a bar redrawn ten times a second makes a log of escape codes."""
    words = ["render", folder / "shell.safetensors", "-o", tmp_path / "a.exr", "--size", "64"]
    log = tmp_path / "log"
    with log.open("w") as file:
        done = subprocess.run(
            [sys.executable, "-m", "raden_torch.cli", *map(str, words)],
            stdout=subprocess.DEVNULL,
            stderr=file,
            env={**os.environ, "TERM": "xterm-256color"},
        )
    assert done.returncode == 0
    assert log.read_text() == ""


def test_the_page_names_the_exit_codes_and_options_of_help(raden: Command) -> None:
    text = " ".join(raden("-h").stdout.split())
    page = PAGE.read_text("utf-8")
    for option in ("--quiet", "-q", "--verbose", "--install-completion", "--version"):
        assert option in text
        assert option in page
    codes = re.findall(r"^\| (\d|128 \+ n) \|", page, re.MULTILINE)
    assert codes == ["0", "1", "2", "3", "128 + n"]
    said = text[text.index("Exit codes: ") :]
    assert all(f"{code} " in said for code in codes)


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_completion_completes(raden: Command, tmp_path: Path) -> None:
    script = tmp_path / "raden.bash"
    done = raden("--install-completion", "--shell", "bash", "--output", script)
    assert done.returncode == 0
    asked = {
        "re": "render relight",
        "capture seg": "segment",
        "fit --diffuse ": "floor surface",
        "fit --diffuse-s": "--diffuse-scale",
    }
    for words, wanted in asked.items():
        line = ["raden", *words.split(" ")]
        quoted = " ".join(f"'{word}'" for word in line)
        code = f"source {script}; COMP_WORDS=({quoted}); COMP_CWORD={len(line) - 1}; _raden"
        found = subprocess.run(
            ["bash", "--norc", "-c", f"{code}; echo ${{COMPREPLY[@]}}"],
            capture_output=True,
            text=True,
        )
        assert found.stdout.split() == wanted.split(), (words, found.stderr)
