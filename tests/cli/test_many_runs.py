"""`raden fit -o FOLDER` and `raden sweep`: one command, many results."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse


@pytest.fixture
def folder(tmp_path: Path, analytic) -> Path:
    """Two simulated measurements, a broken one, and a matt model."""
    for name, body in (("rim", 20.0), ("eye", 40.0)):
        analytic(body=body, step=35.0).save(tmp_path / f"{name}.csv")
    (tmp_path / "broken.csv").write_text("incidence_deg,x\n1,2\n")
    matt = rt.RadenBrdf(CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.ones(3)), None)
    rt.save_model(matt, tmp_path / "matt.safetensors")
    return tmp_path


def test_a_model_is_the_same_bytes_each_time_it_is_written(folder: Path) -> None:
    """Rationale: safetensors leaves the order of its metadata to chance, and the models of a
    cluster are to be those of one machine."""
    model = rt.load_model(folder / "matt.safetensors")
    paths = [folder / f"{number}.safetensors" for number in range(8)]
    for path in paths:
        rt.save_model(model, path)
    assert {path.read_bytes() for path in paths} == {(folder / "matt.safetensors").read_bytes()}


FIT = ("--interpolation", "trilinear", "-o", "models")


@pytest.mark.slow
def test_a_folder_gets_a_model_of_each_measurement(folder: Path, raden) -> None:
    done = raden("fit", "rim.csv", "broken.csv", "eye.csv", *FIT, cwd=folder)
    assert done.returncode == 3, done.stderr
    assert done.stderr.startswith("raden: broken.csv: columns ")
    assert "2 written, 1 failed (broken.csv)" in done.stdout
    raden("fit", "eye.csv", "--interpolation", "trilinear", "-o", "one.safetensors", cwd=folder)
    one = (folder / "one.safetensors").read_bytes()
    assert (folder / "models/eye.safetensors").read_bytes() == one
    assert sorted(p.name for p in (folder / "models").iterdir()) == [
        "eye.safetensors",
        "rim.safetensors",
    ]
    again = raden("fit", "rim.csv", "eye.csv", *FIT, cwd=folder)
    assert (again.returncode, "2 kept" in again.stdout) == (0, True)


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (("rim.csv", "./rim.csv", *FIT), "models: expected a different name for each measurement"),
        (("rim.csv", *FIT, "--names", "a"), "--names: expected a palette in one file"),
        (("rim.csv", "-o", "m.safetensors", "--force"), "m.safetensors: expected a folder"),
        (("rim.csv", *FIT, "--engine", "dask"), "--engine dask and --scheduler go together"),
        (("rim.csv", *FIT, "--wait", "5"), "--wait and --mixed-workers: expected with --engine"),
    ],
)
def test_what_a_folder_does_not_take(folder: Path, raden, arguments, wanted: str) -> None:
    done = raden("fit", *arguments, cwd=folder)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"raden: {wanted}")
    assert not (folder / "models").exists()


SWEEP = ("-o", "lit", "--", "render", "matt.safetensors", "--size", "16")


def test_each_row_of_a_sweep_is_the_command_with_its_options(folder: Path, raden) -> None:
    (folder / "t.csv").write_text('name,light,exposure\na.png,"1,1,2",0\nb.png,,1\n')
    done = raden("sweep", "t.csv", *SWEEP, cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert "2 written" in done.stdout
    own = ("matt.safetensors", "--size", "16")
    raden("render", *own, "--light", "1,1,2", "--exposure", "0", "-o", "own_a.png", cwd=folder)
    raden("render", *own, "--exposure", "1", "-o", "own_b.png", cwd=folder)
    for name in ("a.png", "b.png"):
        assert (folder / "lit" / name).read_bytes() == (folder / f"own_{name}").read_bytes()
    assert "2 kept" in raden("sweep", "t.csv", *SWEEP, cwd=folder).stdout


def test_a_row_that_fails_is_told_and_the_rest_goes_on(folder: Path, raden) -> None:
    (folder / "t.csv").write_text("name,shape\na.png,cube\nb.png,sphere\n")
    done = raden("sweep", "t.csv", *SWEEP, cwd=folder)
    assert done.returncode == 3
    assert "raden: a.png: shape: expected sphere, plate, board, got cube" in done.stderr
    assert [p.name for p in (folder / "lit").iterdir()] == ["b.png"]


@pytest.mark.parametrize(
    ("table", "wanted"),
    [
        ("name,lihgt\na.png,1\n", "t.csv: a.png: --lihgt: no such option, did you mean --light?"),
        ("light\n1\n", "t.csv: expected a line of column names, one of them name, got light"),
        ("name\n", "t.csv: expected 1…1000000 rows, got 0"),
        ("name,light\na.png\n", "t.csv: row 2: expected 2 cells, got 1"),
        ("name\n../a.png\n", "t.csv: row 2: name: expected a file name, different in each row"),
        ("name\na.png\na.png\n", "t.csv: row 3: name: expected a file name, different in each"),
    ],
)
def test_a_table_that_says_nothing_of_use(folder: Path, raden, table: str, wanted: str) -> None:
    (folder / "t.csv").write_text(table)
    done = raden("sweep", "t.csv", *SWEEP, cwd=folder)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"raden: {wanted}")
    assert not (folder / "lit").exists()


def test_a_sweep_is_of_commands_that_write_one_file(folder: Path, raden) -> None:
    (folder / "t.csv").write_text("name\na.png\n")
    done = raden("sweep", "t.csv", "-o", "lit", "--", "info", "matt.safetensors", cwd=folder)
    assert done.returncode == 2
    assert "expected render, fit, relight, plot, export after --, got info" in done.stderr


def test_a_row_of_a_sweep_is_no_sequence(folder: Path, raden) -> None:
    (folder / "t.csv").write_text("name,frames\na.png,1-2\n")
    done = raden("sweep", "t.csv", *SWEEP, cwd=folder)
    assert done.returncode == 2
    assert "a.png: expected one file a row, got --frames" in done.stderr
