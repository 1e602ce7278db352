"""`raden relight --frames`: photographs with one normal map, or one a frame."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from raden_torch.cli import run
from raden_torch.errors import InputError
from raden_torch.images.pixels import read_image

Photographs = Callable[..., Path]


def relight(photo: Path, normals: Path, model: Path, output: Path, *words: str) -> int:
    given = ["--normals", str(normals), "--model", str(model), "-o", str(output), *words]
    try:
        run(["relight", str(photo), *given])
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def test_a_frame_is_what_the_single_command_writes(
    model_file: Path, photographs: Photographs, tmp_path: Path
) -> None:
    pattern, out = photographs(1, 2, 3), tmp_path / "lit.####.png"
    each = tmp_path / "normal.####.png"
    assert relight(pattern, each, model_file, out, "--frames", "1-3", "--exposure", "0.5") == 0
    for number in (1, 2, 3):
        photo, normal = (tmp_path / f"{name}.{number:04d}.png" for name in ("box", "normal"))
        single = tmp_path / "single.png"
        assert relight(photo, normal, model_file, single, "--exposure", "0.5") == 0
        assert single.read_bytes() == (tmp_path / f"lit.{number:04d}.png").read_bytes()


def test_one_normal_map_for_all_and_one_gain(
    model_file: Path, photographs: Photographs, tmp_path: Path
) -> None:
    pattern, normal = photographs(1, 2), tmp_path / "normal.png"
    folder = tmp_path / "relit"
    assert relight(pattern, normal, model_file, folder, "--frames", "1-2") == 0
    frames = [read_image(folder / f"box.000{n}.png").pixels for n in (1, 2)]
    # where everything is relit, and the gain is that of the first frame, both frames are alike
    assert np.array_equal(*frames)
    single = tmp_path / "single.png"
    relight(tmp_path / "box.0001.png", normal, model_file, single)
    assert np.abs(read_image(single).pixels.astype(int) - frames[0]).max() <= 1


def test_contact_sheets(model_file: Path, photographs: Photographs, tmp_path: Path) -> None:
    pattern, normal = photographs(1, 2), tmp_path / "normal.png"
    out = tmp_path / "sheet.####.png"
    assert relight(pattern, normal, model_file, out, "--frames", "1-2", "--sheet", "6") == 0
    single = tmp_path / "single.png"
    relight(tmp_path / "box.0002.png", normal, model_file, single, "--sheet", "6")
    assert single.read_bytes() == (tmp_path / "sheet.0002.png").read_bytes()


def test_frames_that_are_missing_or_differ(
    model_file: Path,
    photographs: Photographs,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pattern, each = photographs(1, 2, 3), tmp_path / "normal.####.png"
    out = tmp_path / "lit.####.png"
    (tmp_path / "normal.0002.png").unlink()
    with pytest.raises(InputError, match=r"normal\.####\.png: expected frames 1-3, missing are 2"):
        relight(pattern, each, model_file, out, "--frames", "1-3")
    photographs(2, height=12)
    assert relight(pattern, each, model_file, out, "--frames", "1-3") == 3
    assert "as box.0001.png has, got 32 x 12" in capsys.readouterr().err
    assert (tmp_path / "lit.0003.png").exists()
    assert not (tmp_path / "lit.0002.png").exists()


def test_what_is_refused(model_file: Path, photographs: Photographs, tmp_path: Path) -> None:
    pattern, normal = photographs(1, 2), tmp_path / "normal.png"
    out = tmp_path / "lit.####.png"
    with pytest.raises(InputError, match="expected `frames`, as 1-2, got none"):
        relight(pattern, normal, model_file, out)
    with pytest.raises(InputError, match=r"as shot\.####\.png, with `frames`, got none"):
        relight(tmp_path / "box.0001.png", normal, model_file, out, "--frames", "1-2")
    with pytest.raises(InputError, match="expected one name"):
        relight(pattern, normal, model_file, out, str(tmp_path / "box.0001.png"), "--frames", "1")
    assert not list(tmp_path.glob("lit*"))
