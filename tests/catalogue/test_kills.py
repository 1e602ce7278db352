"""A writer that is killed leaves the catalogue as it was before the addition, or after it."""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from raden_torch.catalogue import Catalogue
from raden_torch.catalogue.store import Store

pytest.importorskip("fcntl")


@pytest.fixture(scope="module")
def killed() -> Iterator[Callable[[Path, Path, int], int]]:
    """Adds a file in a process that is killed; see `killed_writer.py`."""
    script = Path(__file__).with_name("killed_writer.py")
    with subprocess.Popen(
        [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None

        def add(folder: Path, file: Path, when: int) -> int:
            process.stdin.write(f"{folder}\t{file}\t{when}\n")
            process.stdin.flush()
            return int(process.stdout.readline())

        yield add
        process.stdin.close()


def whole(folder: Path) -> set[str]:
    """The IDs of a catalogue, each of whose shells is as it was added."""
    catalogue = Catalogue(folder)
    assert list(catalogue.damages()) == []
    entries = [found.entry for found in catalogue.find()]
    assert len(entries) == len(catalogue)
    assert [entry.number for entry in entries] == list(range(len(entries)))
    return {entry.sha256 for entry in entries}


def left_over(folder: Path) -> set[str]:
    """Files that no reader looks at."""
    contents = Store(folder).contents()
    named = {folder / "catalogue.json", folder / "writer.lock"}
    named |= {folder / "index" / segment.file for segment in contents.segments}
    shells = [Catalogue(folder).file(found.entry) for found in Catalogue(folder).find()]
    named |= {*shells, *(shell.with_name("thumbnail.png") for shell in shells)}
    return {str(path) for path in folder.rglob("*") if path.is_file()} - set(map(str, named))


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_killed_before_every_call_that_changes_the_folder(killed, tmp_path: Path) -> None:
    """The fourth shell, with which three index files become one, added in a process that is killed
    before its first call, its second, and so on. Expected: three shells or four, all whole; the
    next writer clears what was left."""
    base, shell, next_one = tmp_path / "base", tmp_path / "shell.csv", tmp_path / "next.csv"
    shell.write_text("a shell")
    next_one.write_text("the next shell")
    catalogue = Catalogue(base, create=True)
    for name in ("a", "b", "c"):
        (tmp_path / name).write_text(name)
        catalogue.add(tmp_path / name)
    before, states = whole(base), set()
    for when in range(1, 200):
        folder = tmp_path / str(when)
        shutil.copytree(base, folder)
        ended_by = killed(folder, shell, when)
        now = whole(folder)
        assert before <= now
        states.add((len(now), bool(left_over(folder))))
        Catalogue(folder).add(next_one)
        assert len(whole(folder)) == len(now) + 1
        assert left_over(folder) == set()
        if ended_by == 0:
            break
        assert ended_by == signal.SIGKILL
    assert when > 20
    assert states == {(3, False), (3, True), (4, True), (4, False)}


def test_killed_at_random_moments(killed, tmp_path: Path) -> None:
    folder, ids = tmp_path / "shells", set()
    draw = random.Random(0)
    for attempt in range(200):
        file = tmp_path / f"{attempt}.csv"
        file.write_text(f"shell {attempt}")
        assert killed(folder, file, -draw.randint(1, 200)) == signal.SIGKILL
        if (folder / "catalogue.json").exists():
            now = whole(folder)
            assert ids <= now
            ids = now
        if attempt >= 10 and len(ids) > 4:
            break
    assert len(ids) > 4
    file.write_text("the last one")
    assert killed(folder, file, 10_000) == 0
    assert len(whole(folder)) == len(ids) + 1
    assert left_over(folder) == set()


def test_a_catalogue_whose_beginning_was_killed_is_begun_again(killed, tmp_path: Path) -> None:
    folder = tmp_path / "shells"
    (folder / "index").mkdir(parents=True)
    (folder / "writer.lock").touch()
    (folder / ".catalogue.0123abcd.json").touch()
    file = tmp_path / "a.csv"
    file.write_text("a shell")
    assert killed(folder, file, 10_000) == 0
    assert len(whole(folder)) == 1
    assert left_over(folder) == set()
