"""`raden export` and `raden verify` of files for Mitsuba 3 and pbrt-v4."""

from __future__ import annotations

from pathlib import Path

import pytest

import raden_torch as rt
from raden_torch.cli import run
from raden_torch.errors import InputError
from tests.export.mitsuba.shells import simulated_shell


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "shell.safetensors"
    rt.save_model(simulated_shell("akoya"), path)
    return path


def refusal(*words: object) -> str:
    with pytest.raises(InputError) as caught:
        run([*map(str, words)])
    return str(caught.value)


def test_a_plugins_file_is_written_and_refused(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(["export", str(model), "-o", str(tmp_path / "shell.xml")])
    said = capsys.readouterr().out
    assert "Mitsuba 3 BSDF: a table of 80000 bytes" in said
    assert all(f"shell{suffix}" in said for suffix in (".xml", ".bin", ".json"))
    (tmp_path / "shell.bin").write_bytes(b"cut")
    said = refusal("verify", tmp_path / "shell.xml")
    assert "shell.bin: expected 80000 bytes, got 3" in said
    out = tmp_path / "other.xml"
    assert "--average: expected with a .bsdf file" in refusal(
        "export", model, "-o", out, "--average"
    )
    assert not out.exists()


def test_a_measured_file_is_written_and_checked(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mitsuba", reason="needs the extra simulate")
    file = tmp_path / "shell.bsdf"
    run(["export", str(model), "-o", str(file), "--spectra"])
    said = capsys.readouterr().out
    assert "x 21 wavelengths" in said
    assert "% of the reflection" in said
    run(["verify", str(file)])
    assert "Mitsuba's measured (scalar_spectral): same reflection" in capsys.readouterr().out
    file.write_bytes(file.read_bytes()[:-1])
    assert "field 'spectra': expected" in refusal("verify", file)
    assert "--fixed: expected with an .onnx file" in refusal(
        "export", model, "-o", tmp_path / "a.bsdf", "--fixed"
    )
