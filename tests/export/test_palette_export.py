"""A palette, and a coat, as one ONNX file: the picture that torch makes, whatever chooses."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.metal import Foil, Powder
from raden_torch.brdf.materials.one_table import one_table
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.runtime import RuntimeBrdf
from raden_torch.brdf.materials.urushi import BLACK, Lambertian
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.errors import InputError
from raden_torch.export.export import verify_onnx
from raden_torch.export.shader_session import ShaderSession


def table(shape: tuple[int, int, int], warp: tuple[float, float], phase: float) -> RuntimeBrdf:
    """A smooth function in the half-vector frame; every member has its own nodes and warp."""
    axes = (torch.linspace(low, 1, n) for low, n in zip((0, -1, -1), shape, strict=True))
    u, v, w = torch.meshgrid(*axes, indexing="ij")
    k = phase * torch.tensor([1.0, 0.7, 0.4]).view(3, 1, 1, 1)
    f = 0.2 + 0.1 * torch.cos(k * (1 + u) + v) + 0.05 * torch.sin(k + 2 * w) * torch.exp(-4 * v * v)
    return RuntimeBrdf(f.movedim(0, -1).contiguous(), RuntimeLayout(shape, warp))


@pytest.fixture(scope="module")
def palette() -> Palette:
    members = [
        table((9, 17, 13), (0.4, 0.4), 1.0),
        table((8, 12, 10), (0.3, 0.6), 2.0),
        table((12, 15, 16), (0.5, 0.35), 3.0),
    ]
    return Palette(members, ("akoya", "awabi", "urushi"))


@pytest.fixture(scope="module")
def files(palette: Palette, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder, made = tmp_path_factory.mktemp("palette"), {}
    for by in ("index", "weights"):
        made[by] = folder / f"{by}.onnx"
        report = rt.export_onnx(palette, made[by], material=by)
        assert report.form == "palette"
        assert report.runtimes[0].status == "same picture"
        assert max(r.largest for r in report.runtimes[0].regions.values()) < 5e-5
    return made


def scene() -> dict[str, torch.Tensor]:
    draw = torch.Generator().manual_seed(4)
    normal = torch.randn(2, 3, 20, 24, generator=draw) * 0.3 + torch.tensor([0, 0, 1.0]).view(
        3, 1, 1
    )
    return {
        "normal": normal,
        "light": torch.tensor([0.5, 0.4, 1.0]).view(1, 3, 1, 1),
        "view": torch.tensor([-0.2, 0.1, 1.0]).view(1, 3, 1, 1),
        "material": torch.randint(0, 3, (2, 1, 20, 24), generator=draw),
        "weights": torch.rand(2, 3, 20, 24, generator=draw),
    }


@pytest.mark.parametrize("by", ["index", "weights"])
def test_the_file_shows_what_shade_shows(palette: Palette, files: dict[str, Path], by: str) -> None:
    given = scene()
    weights = given["weights"] / given["weights"].sum(1, keepdim=True)
    material = given["material"] if by == "index" else weights
    lamp = rt.DirectionalLight((0.5, 0.4, 1.0), torch.pi)
    view = (-0.2, 0.1, 1.0)
    wanted = rt.shade(palette, rt.GBuffer(given["normal"], view, material=material), lamp)
    vectors = {name: given[name].numpy() for name in ("normal", "light", "view")}
    name = "material" if by == "index" else "weights"
    inputs = vectors | {name: material.float().numpy()}
    session = ort.InferenceSession(files[by], providers=["CPUExecutionProvider"])
    image = session.run(None, inputs)[0]
    np.testing.assert_allclose(image, wanted, atol=3e-6 * float(wanted.max()))
    tiled = ShaderSession(files[by], tile=100).run(**inputs)
    np.testing.assert_allclose(tiled, wanted, atol=3e-6 * float(wanted.max()))


def test_what_is_no_index_is_nothing(files: dict[str, Path]) -> None:
    session = ort.InferenceSession(files["index"], providers=["CPUExecutionProvider"])
    odd = np.array([-1, 3, 1e30, np.nan, -np.inf, 1.4, 1.6, 0], np.float32).reshape(1, 1, 1, 8)
    up = np.float32([0, 0, 1]).reshape(1, 3, 1, 1)
    image = session.run(
        None, {"normal": up.repeat(8, 3), "light": up, "view": up, "material": odd}
    )[0]
    assert (image[..., :5] == 0).all()
    assert (image[..., 5:] > 0).all()
    assert len({tuple(image[0, :, 0, k]) for k in (5, 6, 7)}) == 3


def test_one_file_says_what_is_in_it(files: dict[str, Path], palette: Palette) -> None:
    graph = onnx.load(str(files["index"]))
    texts = {entry.key: entry.value for entry in graph.metadata_props}
    assert json.loads(texts["materials"]) == list(palette.names)
    assert texts["form"] == "palette"
    assert texts["optional_inputs"] == "mask, irradiance, exposure, table_0, table_1, table_2"
    assert [i.name for i in graph.graph.input][:4] == ["normal", "light", "view", "material"]
    assert texts["table_address"].count("table_") == 3
    assert len(graph.graph.node) < 200


def test_another_shell_in_a_members_place(files: dict[str, Path], palette: Palette) -> None:
    given = scene()
    vectors = {name: given[name].numpy() for name in ("normal", "light", "view")}
    inputs = vectors | {"material": given["material"].float().numpy()}
    other = {"table_1": 2 * palette[1].values.numpy()}
    plain, changed = (
        ShaderSession(files["index"], parameters=p).run(**inputs) for p in ({}, other)
    )
    factor = np.where(given["material"] == 1, 2, 1)
    np.testing.assert_allclose(changed, plain * factor, rtol=1e-5, atol=1e-6)
    with pytest.raises(InputError, match="table_1: expected shape"):
        ShaderSession(files["index"], parameters={"table_1": np.ones((2, 3, 4, 3))})


def test_a_file_is_verified_from_itself(files: dict[str, Path]) -> None:
    report = verify_onnx(files["index"])
    assert [r.status for r in report.runtimes if r.name == "onnxruntime"] == ["same picture"]
    assert not report.failures


def test_materials_as_one_table() -> None:
    """Coats, foils and powder, baked: their formulas, at geometries between the nodes."""
    draw = torch.Generator().manual_seed(5)
    n, l, v = (  # noqa: E741
        torch.nn.functional.normalize(
            torch.randn(1, 3, 1, 400, generator=draw, dtype=torch.float64)
            + torch.tensor([0, 0, 2.0]).view(3, 1, 1),
            dim=1,
        )
        for _ in range(3)
    )
    gold = Foil("gold", 0.4)
    for material, formula in (
        (gold, gold.of_unit_vectors),
        (powder := Powder(gold, Lambertian(BLACK), 0.3), powder.of_unit_vectors),
        (coat := Coated(Lambertian(BLACK), roughness=0.2), coat.formula),
    ):
        baked = one_table(material)
        found = baked.of_unit_vectors(n.float(), l.float(), v.float())
        wanted = formula(n, l, v)
        assert (found - wanted).abs().mean() < 0.02 * wanted.mean()


@pytest.mark.parametrize(
    ("material", "options", "message"),
    [
        (Foil("gold", 0.02), {}, "roughness: expected at least 0.03"),
        (
            Palette([Powder(Foil("gold"), Lambertian(BLACK), torch.full((1, 1, 2, 2), 0.5))]),
            {},
            "palette: 1: density: expected one number, got a map",
        ),
        (Palette([Lambertian(BLACK)]), {"form": "fit"}, "form: expected runtime"),
        (Palette([Lambertian(BLACK)]), {"material": "name"}, "material: expected one of index, we"),
        (
            Palette([Lambertian(BLACK)]),
            {"material": "weights", "profile": "scene"},
            "expected index with the scene profile",
        ),
    ],
)
def test_what_is_not_exported(
    material: object, options: dict[str, str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message) as error:
        rt.export_onnx(material, tmp_path / "x.onnx", **options)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_from_the_command_line(
    raden: Callable[..., subprocess.CompletedProcess[str]], palette: Palette, tmp_path: Path
) -> None:
    rt.save_model(palette, tmp_path / "p.safetensors")
    done = raden(
        "export", tmp_path / "p.safetensors", "-o", tmp_path / "p.onnx", "--profile", "scene"
    )
    assert done.returncode == 0, done.stderr
    assert "palette form, scene profile" in done.stdout
    said = raden("info", tmp_path / "p.onnx").stdout
    assert "materials: 0: akoya, 1: awabi, 2: urushi" in said
    done = raden("export", tmp_path / "p.safetensors", "-o", tmp_path / "p.html")
    assert done.returncode == 2
    assert "got a palette of 3" in done.stderr
