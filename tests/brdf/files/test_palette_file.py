"""Palettes and coats as files: everything comes back, and what is wrong is one line."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open

import raden_torch as rt
from raden_torch.brdf.files.model_file import load_brdf
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.metal import Foil, Powder
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.runtime import RuntimeBrdf
from raden_torch.brdf.materials.urushi import BLACK, Lambertian
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.errors import InputError
from raden_torch.info import describe_file

NAMES = ("akoya", "yakogai", "akoya under urushi", "gold", "body", "table")


@pytest.fixture(scope="module")
def palette() -> Palette:
    akoya, yakogai = (
        rt.fit(rt.simulate_specimen(name, step_deg=35)).model for name in ("akoya", "yakogai")
    )
    yakogai.specular_gain = 0.75
    coat = Coated(akoya, 1.5, (3, 10, 30), 0.02, 0.1, "air")
    gold = Powder(Foil("gold", 0.4, 1.2), Foil("silver", 0.3), 0.25)
    values = torch.rand(3, 5, 4, 3)
    table = RuntimeBrdf(values, RuntimeLayout((3, 5, 4), (0.5, 0.5)))
    return Palette([akoya, yakogai, coat, gold, Lambertian(BLACK), table], NAMES)


@pytest.fixture
def path(palette: Palette, tmp_path: Path) -> Path:
    rt.save_model(palette, tmp_path / "p.safetensors")
    return tmp_path / "p.safetensors"


def scene(members: int) -> rt.GBuffer:
    draw = torch.Generator().manual_seed(0)
    normal = torch.randn(1, 3, members, 20, generator=draw) * 0.3 + torch.tensor([0, 0, 1.0]).view(
        3, 1, 1
    )
    index = torch.arange(members).view(1, 1, members, 1)
    return rt.GBuffer(normal, (0, 0, 1), material=index)


def test_a_palette_comes_back_with_all_it_is_made_of(palette: Palette, path: Path) -> None:
    loaded = rt.load_model(path)
    assert loaded.names == NAMES
    assert [type(m) for m in loaded] == [type(m) for m in palette]
    assert loaded[2].base is loaded[0]  # one model, shown by two members
    plain = [json.loads(json.dumps(vars(p[0].provenance))) for p in (loaded, palette)]
    assert plain[0] == plain[1]
    lamp = rt.DirectionalLight((1, 1, 2))
    gbuffer = scene(len(palette))
    assert torch.equal(rt.shade(loaded, gbuffer, lamp), rt.shade(palette, gbuffer, lamp))


def test_a_coat_alone_comes_back(palette: Palette, tmp_path: Path) -> None:
    rt.save_model(palette[2], tmp_path / "coat.safetensors")
    loaded = rt.load_model(tmp_path / "coat.safetensors")
    gbuffer = rt.GBuffer(scene(2).normal, (0, 0, 1))
    lamp = rt.DirectionalLight((1, 1, 2))
    assert torch.equal(rt.shade(loaded, gbuffer, lamp), rt.shade(palette[2], gbuffer, lamp))


def test_the_file_is_plain_tensors_and_names_its_sources(palette: Palette, path: Path) -> None:
    with safe_open(str(path), "pt") as file:
        about = json.loads(file.metadata()["about"])
        assert "models.0.table.values" in file.keys()  # noqa: SIM118
    hashes = [own["provenance"]["measurement_sha256"] for own in about["models"][:2]]
    assert hashes == [palette[k].provenance.measurement_sha256 for k in (0, 1)]
    said = describe_file(path)
    for words in (*NAMES, *hashes, "palette of 6", "coat of index 1.5", "covers 25 %", "gold foil"):
        assert words in said


def changed(path: Path, change: Callable[[dict[str, Any], dict[str, Any]], None]) -> None:
    data = path.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    about = json.loads(header["__metadata__"]["about"])
    change(header, about)
    header["__metadata__"]["about"] = json.dumps(about)
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + length :])


def _set(*way: Any, to: Any) -> Callable[[dict[str, Any], dict[str, Any]], None]:
    def change(header: dict[str, Any], about: dict[str, Any]) -> None:
        inside: Any = about
        for key in way[:-1]:
            inside = inside[key]
        inside[way[-1]] = to

    return change


DAMAGE = {
    "newer": (_set("version", to=4), "expected up to 3, got 4"),
    "colour": (_set("models", 1, "colour", to="XYZ"), r"models\[1\]: colour: expected linear RGB"),
    "quantity": (_set("quantity", to="reflectance factor"), "quantity: expected f_r in 1/sr"),
    "kind": (_set("palette", 3, "material", "kind", to="Pickle"), "gold: kind: expected one of"),
    "coat": (_set("palette", 2, "material", "thickness", to=-1), "under urushi: thickness: expect"),
    "index": (_set("palette", 2, "material", "base", "model", to=9), r"base: model: expected 0…2"),
    "type": (_set("palette", 2, "material", "index", to="1.5"), "index: expected"),
    "members": (_set("palette", to=[]), "expected at least one model"),
    "list": (_set("palette", to=7), "damaged"),
    "nested": (_set("palette", 0, "material", to=[[]]), "kind: expected one of"),
    "layout": (_set("models", 2, "runtime", "shape", to=[3, 5, 5]), r"got \[3, 5, 4, 3\]"),
    "tensor": (lambda header, _: header.pop("models.2.values"), "damaged"),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_damage_is_one_line(path: Path, what: str) -> None:
    change, words = DAMAGE[what]
    changed(path, change)
    with pytest.raises(InputError, match=words) as error:
        rt.load_model(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_truncated_file_and_values_that_are_not_finite(path: Path, palette: Palette) -> None:
    whole = path.read_bytes()
    for length in (4, len(whole) // 2, len(whole) - 5):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"p\.safetensors"):
            rt.load_model(path)
    path.write_bytes(whole[:-4] + struct.pack("<f", float("nan")))
    with pytest.raises(InputError, match="expected finite values"):
        rt.load_model(path)


def test_what_a_file_cannot_hold(palette: Palette, path: Path) -> None:
    class Mine:
        def of_unit_vectors(self, n, l, v):  # noqa: E741
            return n

    powder = Powder(Foil("gold"), Lambertian(BLACK), torch.full((1, 1, 2, 2), 0.5))
    before = path.read_bytes()
    for material, words in ((Mine(), "got Mine"), (powder, "expected one number, got a map")):
        with pytest.raises(InputError, match=f"palette: odd: .*{words}"):
            rt.save_model(Palette([palette[0], material], ("fine", "odd")), path)
    assert path.read_bytes() == before


def test_what_needs_one_model_says_so(path: Path) -> None:
    with pytest.raises(InputError, match=r"plot: expected the model of one.*a palette of 6"):
        load_brdf(path, "plot")
