"""GLSL and WGSL: the files, the text's cost, and a browser's picture of it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model.model import Provenance
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.errors import InputError
from raden_torch.export.shading_language import LANGUAGES, export_shader
from raden_torch.export.shading_language_check import verify_shader

MODULES = Path(__file__).resolve().parents[2] / "runtimes/node_modules"
MOST_OPERATIONS = 80
"""Scalar operations of the optimised function, beside the fetch."""

needs_browser = pytest.mark.skipif(
    not (
        shutil.which("node")
        and (shutil.which("chromium") or shutil.which("google-chrome"))
        and (MODULES / "playwright-core").is_dir()
    ),
    reason="Node.js, Chromium or playwright-core is not installed; make runtimes",
)


@pytest.fixture(scope="module")
def model() -> rt.RadenBrdf:
    return rt.fit(rt.simulate_specimen("yakogai", step_deg=10)).model


@pytest.mark.parametrize("suffix", LANGUAGES)
def test_the_table_beside_the_text_is_the_models(model, suffix, tmp_path):
    report = export_shader(model, tmp_path / f"shell{suffix}")
    about = json.loads((tmp_path / "shell.json").read_text())
    sides = [about[side] for side in ("depth", "height", "width")]
    texels = np.fromfile(tmp_path / "shell.bin", "<f2").reshape(*sides, 4)
    table = model.runtime_table().detach().numpy()
    np.testing.assert_allclose(texels[..., :3], table, rtol=2**-11, atol=2**-25)
    assert (texels[..., 3] == 1).all()
    assert report.half_precision < 2**-11
    assert about["bytes"] == report.table_bytes == texels.nbytes
    text = (tmp_path / f"shell{suffix}").read_text()
    assert "SIMULATED sample: yakogai" in text
    assert "shell.bin" in text
    assert len(re.findall(r"texture(Lod|SampleLevel)\(", text)) == 1
    assert not re.search(r"\b(if|for|while|discard)\b", text.split("{", 1)[1])


@needs_browser
@pytest.mark.slow
@pytest.mark.parametrize("suffix", LANGUAGES)
def test_a_browser_gives_torchs_picture(model, suffix, tmp_path):
    path = tmp_path / f"shell{suffix}"
    export_shader(model, path)
    check = verify_shader(path, node_modules=MODULES)
    assert check.pixels > 40_000
    assert check.displayed < 0.2 / 255
    assert check.per_sr < 1e-3 * check.peak_per_sr
    # a wrong constant is found
    path.write_text(path.read_text().replace("0.25", "0.75", 1).replace("2.0 +", "1.0 +"))
    with pytest.raises(InputError, match="within 1/255"):
        verify_shader(path, node_modules=MODULES)
    path.write_text(path.read_text().replace("cross(", "krosse("))
    with pytest.raises(InputError, match=r"the browser cannot run it: .*krosse"):
        verify_shader(path, node_modules=MODULES)


@pytest.mark.skipif(
    not (shutil.which("glslangValidator") and shutil.which("spirv-opt")),
    reason="glslangValidator or spirv-opt is not installed",
)
def test_the_function_is_short(model, tmp_path):
    export_shader(model, tmp_path / "shell.glsl")
    text = (tmp_path / "shell.glsl").read_text().replace("precision highp float;", "")
    text = text.replace("uniform highp", "layout(binding = 0) uniform highp")
    ports = "".join(f"layout(location = {i}) in vec3 {x};" for i, x in enumerate("NLV"))
    (tmp_path / "shell.frag").write_text(
        f"#version 450\n{text}{ports}layout(location = 0) out vec3 o;"
        "void main() { o = raden_brdf(N, L, V); }"
    )
    for command in (
        ["glslangValidator", "-V", "shell.frag", "-o", "shell.spv"],
        ["spirv-opt", "-O", "shell.spv", "-o", "short.spv"],
        ["spirv-dis", "short.spv", "--raw-id", "-o", "short.txt"],
    ):
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    operations, fetches = scalar_operations((tmp_path / "short.txt").read_text())
    assert fetches == 1
    assert 40 < operations <= MOST_OPERATIONS


def scalar_operations(text: str) -> tuple[int, int]:
    """Arithmetic by component in a SPIR-V listing (a dot product of three is three, a cross
    product six, a multiplication whose product is added nothing of its own), and fetches."""
    lanes = {m[1]: int(m[2]) for m in re.finditer(r"(%\d+) = OpTypeVector %\d+ (\d)", text)}
    count = fetches = 0
    for found in re.finditer(r"= Op(\w+) (%\d+) ?(.*)", text):
        operation, kind, rest = found.groups()
        size = lanes.get(kind, 1)
        if operation == "ExtInst":
            name = rest.split()[1]
            count += {"Cross": 6, "Length": 4}.get(name, size)
        elif operation == "Dot":
            count += 3
        elif operation == "ImageSampleExplicitLod":
            fetches += 1
        elif operation == "Select" or operation.startswith(("F", "Logical", "Vector")):
            count += 0 if operation == "VectorShuffle" else size
    return count, fetches


def test_bad_input_is_one_line(model, tmp_path):
    with pytest.raises(InputError, match=r"suffix: expected \.glsl or \.wgsl, got '\.hlsl'"):
        export_shader(model, tmp_path / "shell.hlsl")
    large = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
    large.layout = RuntimeLayout((8, 8, 400), (0.4, 0.4))
    with pytest.raises(InputError, match=r"at most 256 nodes along each axis.*\[8, 8, 400\]"):
        export_shader(large, tmp_path / "shell.glsl")
    large.layout = RuntimeLayout((8, 8, 8), (0.4, 0.4))
    with torch.no_grad():
        large.table.values.mul_(1e7)
    with pytest.raises(InputError, match="within half precision, 65504 per sr"):
        export_shader(large, tmp_path / "shell.glsl")
    assert not list(tmp_path.iterdir())


def test_a_name_cannot_leave_its_comment(model, tmp_path):
    odd = rt.RadenBrdf(
        model.diffuse,
        model.table,
        layout=model.layout,
        provenance=replace(Provenance(), sample="a\nvoid main() {}", instrument="b\r*/ c"),
    )
    export_shader(odd, tmp_path / "shell.glsl")
    text = (tmp_path / "shell.glsl").read_text()
    assert [line for line in text.splitlines() if "void main" in line or "*/ c" in line]
    assert all(
        line.startswith("//") for line in text.splitlines() if "void main" in line or "*/ c" in line
    )


def test_damaged_files_are_named(model, tmp_path):
    path = tmp_path / "shell.glsl"
    export_shader(model, path)
    table = (tmp_path / "shell.bin").read_bytes()
    (tmp_path / "shell.bin").write_bytes(table[:-2])
    with pytest.raises(InputError, match=rf"shell.bin: expected {len(table)} bytes"):
        verify_shader(path, node_modules=MODULES)
    (tmp_path / "shell.json").write_text("{}")
    with pytest.raises(InputError, match=r"shell.json: expected the description"):
        verify_shader(path, node_modules=MODULES)
    (tmp_path / "shell.json").unlink()
    with pytest.raises(InputError, match=r"shell.json: expected a file of `raden export`"):
        verify_shader(path, node_modules=MODULES)


@pytest.mark.parametrize(("option", "value"), [("--opset", "19"), ("--profile", "scene")])
def test_the_command_refuses_what_onnx_alone_has(raden, model, tmp_path, option, value):
    rt.save_model(model, tmp_path / "shell.safetensors")
    done = raden("export", tmp_path / "shell.safetensors", "-o", tmp_path / "a.glsl", option, value)
    assert done.returncode == 2
    assert f"{option}: expected with an .onnx file, got .glsl" in done.stderr
    done = raden("export", tmp_path / "shell.safetensors", "-o", tmp_path / "a.wgsl")
    assert done.returncode == 0
    assert "wrote" in done.stdout
    assert (tmp_path / "a.wgsl").exists()
