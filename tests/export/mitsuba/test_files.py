"""An exported .xml file: in a scene, checked again, and damaged."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.runtime import RuntimeBrdf
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.errors import InputError
from raden_torch.export.mitsuba import check
from raden_torch.export.mitsuba.check import load, verify_plugin
from raden_torch.export.mitsuba.plugin_file import export_plugin
from raden_torch.packages import MissingPackageError

SCENE = """<scene version="3.0.0">
    <integrator type="direct"/>
    <include filename="shell.xml"/>
    <shape type="sphere"><ref id="shell"/></shape>
    <emitter type="constant"/>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="4"/><integer name="height" value="4"/>
        </film>
    </sensor>
</scene>
"""


@pytest.fixture
def copy(exported: Path, tmp_path: Path) -> Path:
    for file in exported.parent.iterdir():
        shutil.copy(file, tmp_path)
    return tmp_path / exported.name


def test_a_scene_takes_the_file(scalar: Any, copy: Path) -> None:
    (copy.parent / "scene.xml").write_text(SCENE)
    scene = scalar.load_file(str(copy.parent / "scene.xml"))
    assert scene.shapes()[0].bsdf().id() == "shell"
    assert np.array(scalar.render(scene, spp=4)).max() > 0.05


def test_a_model_file_may_be_read_instead(
    scalar: Any, shell: RuntimeBrdf, exported: Path, tmp_path: Path
) -> None:
    rt.save_model(shell, tmp_path / "shell.safetensors")
    own = scalar.load_dict({"type": "raden", "filename": str(tmp_path / "shell.safetensors")})
    si = scalar.SurfaceInteraction3f()
    si.wi = scalar.Vector3f(0.6, 0, 0.8)
    found, wanted = (
        [*bsdf.eval(scalar.BSDFContext(), si, scalar.Vector3f(-0.48, 0.36, 0.8))]
        for bsdf in (own, load(exported, "scalar_rgb"))
    )
    np.testing.assert_allclose(found, wanted, rtol=1e-3)


def test_a_file_is_checked_again(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mitsuba", reason="needs the extra simulate")
    monkeypatch.setattr(check, "why_no_llvm", lambda: "left out here")
    found = verify_plugin(copy)
    assert found.largest < 1e-5
    assert "χ² test left out: left out here" in str(found)
    # the table is another than the description says: the plugin's reflection is another
    table = np.fromfile(copy.with_suffix(".bin"), "<f2")
    form = check.read_form(copy.with_suffix(".json"))
    table.reshape(-1, 4)[:, :3] *= 1.01
    table.tofile(copy.with_suffix(".bin"))
    monkeypatch.setattr(check, "read_form", lambda path: form)
    with pytest.raises(InputError, match=r"within 0\.0001 of the peak, got 0\.0"):
        verify_plugin(copy)


def damaged(about: dict[str, Any], table: bytes, how: str) -> tuple[dict[str, Any], bytes]:
    if how == "cut":
        return about, table[:-100]
    if how == "not finite":
        return about, b"\x00\x7e" + table[2:]  # NaN
    if how == "other end first":
        return about, np.frombuffer(table, "<f2").byteswap().tobytes()
    if how == "too large":
        return about | {"width": 4096, "height": 4096, "depth": 4096}, table
    if how == "endless":
        return about | {"width": 1e400}, table
    return about | {"format": how}, table


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("cut", "shell.bin: expected 80000 bytes, got 79900"),
        ("not finite", "shell.bin: expected finite values"),
        ("other end first", "shell.bin: expected finite values"),
        ("too large", r"expected at most 2097152 nodes, got \[4096, 4096, 4096\]"),
        ("endless", "expected a table's sides and warp"),
        ("another thing", "expected 'raden_torch shader table' version 1, got 'another thing'"),
    ],
)
def test_damaged_tables_are_refused_in_a_line(
    copy: Path, how: str, message: str, scalar: Any
) -> None:
    about = json.loads(copy.with_suffix(".json").read_text())
    about, table = damaged(about, copy.with_suffix(".bin").read_bytes(), how)
    copy.with_suffix(".json").write_text(json.dumps(about))
    copy.with_suffix(".bin").write_bytes(table)
    with pytest.raises(InputError, match=message):
        verify_plugin(copy)
    with pytest.raises(InputError, match="Mitsuba cannot load it"):
        load(copy, "scalar_rgb")


def test_other_files_are_refused(shell: RuntimeBrdf, scalar: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected \.xml"):
        export_plugin(shell, tmp_path / "shell.json5")
    with pytest.raises(InputError, match="expected one material, got a palette"):
        export_plugin(Palette([shell, shell], ("a", "b")), tmp_path / "shell.xml")
    matt = rt.RadenBrdf(CosineDiffuse(torch.ones(3), torch.ones(3)), None)
    with pytest.raises(InputError, match="expected an isotropic sample, got one of 2 azimuths"):
        export_plugin(AnisotropicBrdf([matt, matt], (0, 90)), tmp_path / "shell.xml")
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"absent\.json: expected a file of `raden export`"):
        verify_plugin(tmp_path / "absent.xml")
    with pytest.raises(InputError, match=r"absent\.xml: expected a file of `raden export`"):
        load(tmp_path / "absent.xml", "scalar_rgb")
    (tmp_path / "odd.xml").write_text('<bsdf version="3.0.0" type="raden">')
    with pytest.raises(InputError, match=r"odd\.xml: Mitsuba cannot load it"):
        load(tmp_path / "odd.xml", "scalar_rgb")
    with pytest.raises(RuntimeError, match=r"got \.csv"):
        scalar.load_dict({"type": "raden", "filename": "shell.csv"})


def test_without_mitsuba_the_extra_is_named(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("raden_torch.packages._is_installed", lambda name: name != "mitsuba")
    with pytest.raises(MissingPackageError, match=r"pip install 'raden_torch\[simulate\]'"):
        verify_plugin(copy)
