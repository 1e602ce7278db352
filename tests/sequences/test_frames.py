"""Frame ranges and file names with the frame's number."""

from __future__ import annotations

from pathlib import Path

import pytest

from raden_torch.errors import InputError
from raden_torch.sequences.frames import (
    frame_numbers,
    frame_path,
    frame_range,
    frames_on_disk,
)


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("7", (7,)),
        ("1-4", (1, 2, 3, 4)),
        ("1-10x2,15", (1, 3, 5, 7, 9, 15)),
        ("5-1", (1, 2, 3, 4, 5)),
        ("1-6y2", (2, 4, 6)),
        ("1-6:2", (1, 2, 3, 4, 5, 6)),
        ("1-3, 2-4", (1, 2, 3, 4)),
        ("0001-0003", (1, 2, 3)),
    ],
)
def test_ranges(text: str, numbers: tuple[int, ...]) -> None:
    assert frame_numbers(text) == numbers


@pytest.mark.parametrize(
    "text", ["", " ", ",", "a", "1-", "1--3", "-2", "1.5", "1-3x0", "1-3x-1", "1e3", "1-4\n;x"]
)
def test_what_is_no_range(text: str) -> None:
    with pytest.raises(InputError, match="frames: expected ranges") as caught:
        frame_numbers(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["1-1000001", "1-99999999999999999999"])
def test_too_many_frames(text: str) -> None:
    with pytest.raises(InputError, match="frames: expected"):
        frame_numbers(text)


def test_the_text_of_frames() -> None:
    assert frame_range([1007, 1012, 1010, 1011]) == "1007,1010-1012"
    assert frame_numbers(frame_range([1, 3, 5, 15])) == (1, 3, 5, 15)


@pytest.mark.parametrize(
    ("pattern", "name"),
    [
        ("shot_v2-####.exr", "shot_v2-0007.exr"),
        ("#.png", "7.png"),
        ("shot.@@@.exr", "shot.007.exr"),
        ("shot.%05d.exr", "shot.00007.exr"),
        ("shot%d", "shot7"),
        ("shot.1001.exr", "shot.1001.exr"),
    ],
)
def test_names(pattern: str, name: str) -> None:
    path = Path("100% of #1/a") / pattern
    assert frame_path(path, 7) == path.with_name(name)


def test_a_number_longer_than_its_place_and_two_places() -> None:
    assert frame_path(Path("a.##.exr"), 1001) == Path("a.1001.exr")
    with pytest.raises(InputError, match=r"one place for the frame's number.*got 2"):
        frame_path(Path("a#.##.exr"), 1)


def test_the_frames_that_are_there(tmp_path: Path) -> None:
    for name in ("a.0003.exr", "a.0001.exr", "a.12345.exr", "a.4.exr", "a.0002.png", "b.0005.exr"):
        (tmp_path / name).touch()
    assert frames_on_disk(tmp_path / "a.####.exr") == [1, 3, 12345]
    assert frames_on_disk(tmp_path / "a.%d.exr") == [4, 12345]
    assert frames_on_disk(tmp_path / "none/a.####.exr") == []
    assert frames_on_disk(tmp_path / "a.0001.exr") == []
