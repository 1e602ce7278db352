"""The code of README and docs runs: every block of Python and shell, page by page, in order.

A comment above a block says why it is not run here: `<!-- needs: WHAT -->`, something that no test
has, or `<!-- run by: tests/… -->`. Of its `raden` commands names and options are read all the same.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

PROJECT = Path(__file__).parents[2]
PAGES = [
    PROJECT / "README.md",
    *sorted(PROJECT.glob("docs/*.md")),
    *sorted(PROJECT.glob("examples/**/README.md")),
]
PAGES = [page for page in PAGES if "node_modules" not in page.parts]
WITH_CODE = [page for page in PAGES if "```" in page.read_text("utf-8")]
BLOCK = re.compile(r"(?:<!-- (needs|run by): (.+?) -->\n)?^```(\w*)\n(.*?)^```$", re.M | re.S)
SHOWN_ONLY = {"", "text", "toml", "xml", "js", "json", "bibtex"}  # no code, or tested elsewhere

STANDS_IN = {
    # the same, smaller
    "scan --simulate -o": "scan --simulate --step 35 --time-scale 3000 -o",
    'simulate_specimen("yakogai")': 'simulate_specimen("yakogai", step_deg=35)',
    "--frames 1-48 -o turning.mp4": "--frames 1-2 -o turning.webp",
    "--sheet 12": "--sheet 4",
    "studio.hdr": "studio.exr",
    "room.hdr": "room.exr",
    # Blender's G-buffer is another than that of the plain commands
    "shot.exr --preset blender --camera-file shot.json": (
        "blender.exr --preset blender --camera-file blender.json"
    ),
    "shell.csv --by-azimuth": "turned.csv --by-azimuth",
}


def stood_in(code: str) -> str:
    for shown, instead in STANDS_IN.items():
        code = code.replace(shown, instead)
    return code


@dataclass(frozen=True)
class Block:
    line: int
    language: str
    code: str
    needs: str
    run_by: str


def blocks(page: Path) -> list[Block]:
    text = page.read_text("utf-8")
    found = []
    for match in BLOCK.finditer(text):
        why, what, language, code = match.groups()
        line = text.count("\n", 0, match.start(4))
        needs, run_by = (what if why == word else "" for word in ("needs", "run by"))
        found.append(Block(line, language, code, needs, run_by))
    return found


def commands(code: str) -> Iterator[list[str]]:
    """The words of each command, comments left out."""
    for line in code.replace("\\\n", " ").splitlines():
        if words := shlex.split(stood_in(" ".join(line.split())), comments=True):
            yield words


def read_only(words: list[str]) -> None:
    """The command exists and takes these options; what they name need not be here."""
    from raden_torch.cli.command_table import app

    app.parse_args(words[1:], print_error=False, exit_on_error=False)


def expanded(words: list[str], folder: Path) -> list[str]:
    """As a shell does: patterns of files become their names."""
    named = [sorted(p.name for p in folder.glob(w)) if "*" in w else [w] for w in words]
    return [word for several in named for word in several]


@pytest.fixture
def folder(inputs: Path, tmp_path: Path) -> Path:
    shutil.copytree(inputs, tmp_path / "page")
    return tmp_path / "page"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(PROJECT).as_posix())
def test_every_block_is_known(page: Path) -> None:
    for block in blocks(page):
        where = f"{page.name}, line {block.line}"
        if block.run_by:
            assert (PROJECT / block.run_by).is_file(), where
        assert block.language in {"python", "sh"} | SHOWN_ONLY, where
        if block.language == "sh":
            for words in commands(block.code):
                own = words[0] in ("raden", "python") or block.needs or block.run_by
                assert own, f"{where}: {words[0]} is not run: say why"


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_CODE, ids=lambda p: p.relative_to(PROJECT).as_posix())
def test_the_blocks_run(
    page: Path,
    folder: Path,
    names: dict[str, Any],
    raden: Callable[..., subprocess.CompletedProcess[str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(folder)
    for block in blocks(page):
        where = f"{page.name}, line {block.line}"
        if block.language in SHOWN_ONLY:
            continue
        elsewhere = block.needs or block.run_by
        if block.language == "python":
            if not elsewhere:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # tiny inputs
                    exec(compile(stood_in(block.code), where, "exec"), names)
            continue
        for words in commands(block.code):
            if elsewhere:
                if words[0] == "raden":
                    read_only(words)
                continue
            done = raden(*expanded(words, folder)[1:], warn="ignore")
            assert done.returncode == 0, f"{where}: {shlex.join(words)}\n{done.stderr}"
