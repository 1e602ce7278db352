"""ONNX Runtime's picture against torch's: by region, by size, with other shells, and a real one."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.brdf.shading.sphere_gbuffer import sphere
from raden_torch.errors import InputError
from raden_torch.export.check import LIMITS
from raden_torch.export.constants import fix_parameters
from raden_torch.export.export import verify_onnx
from raden_torch.export.onnx_file import metadata
from raden_torch.export.runtimes import onnx_session
from raden_torch.export.shader_session import ShaderSession

SHARE = 5e-6
"""Of the peak."""


def unit_maps(size: tuple[int, int, int], seed: int = 0) -> dict[str, torch.Tensor]:
    draw = torch.Generator().manual_seed(seed)
    batch, height, width = size
    normal, light, view = torch.randn(3, batch, 3, height, width, generator=draw).double()
    light, view = light + 2 * normal, view + 2 * normal
    maps = {"normal": normal, "light": light, "view": view}
    return {k: torch.nn.functional.normalize(v, dim=1).float() for k, v in maps.items()}


def run(path: Path, inputs: dict[str, torch.Tensor]) -> torch.Tensor:
    session = onnx_session(path.read_bytes(), threads=1)
    return torch.from_numpy(session.run(None, {k: v.numpy() for k, v in inputs.items()})[0])


@pytest.mark.parametrize("profile", ["gbuffer", "scene"])
def test_every_region_is_within_its_limit(
    exported: Callable, shell: rt.RadenBrdf, profile: str
) -> None:
    result = exported(shell, profile=profile).report.runtimes[0]
    assert (result.name, result.status, result.reason) == ("onnxruntime", "same picture", "")
    wanted = set(LIMITS) if profile == "gbuffer" else {"any length", "L parallel to V"}
    assert wanted <= set(result.regions)
    for name, region in result.regions.items():
        assert region.pixels > 50, name
        assert region.largest <= LIMITS[name], name


@pytest.mark.parametrize("size", [(1, 1, 1), (1, 3, 7), (4, 7, 3), (2, 0, 5), (0, 2, 2)])
def test_any_size(exported: Callable, shell: rt.RadenBrdf, size: tuple[int, int, int]) -> None:
    maps = unit_maps(size)
    output = run(exported(shell, profile="gbuffer").path, maps)
    normal, light = maps["normal"], maps["light"]
    cosine = (normal * light).sum(1, keepdim=True).clamp(min=0)
    with torch.no_grad():
        wanted = shell(*maps.values()) * torch.pi * cosine
    assert output.shape == wanted.shape
    torch.testing.assert_close(output, wanted, rtol=1e-5, atol=1e-5)


def test_the_picture_in_double_precision(exported: Callable, shell: rt.RadenBrdf) -> None:
    """Unit vectors: within the limit of the model's own form in float64, not only of float32."""
    maps = unit_maps((1, 96, 96))
    apart = torch.linalg.cross(maps["light"], maps["view"], dim=1).norm(dim=1, keepdim=True) > 0.1
    with torch.no_grad():
        wanted = shell(*(m.double() for m in maps.values()))
    output = run(exported(shell, output="brdf").path, maps)
    error = (output - wanted).abs() * apart
    assert error.max() <= SHARE * wanted.max()


def other_shell(shell: rt.RadenBrdf) -> rt.RadenBrdf:
    """Other colours, other gains, the same nodes."""
    assert shell.table is not None
    values = shell.table.values.detach().flip(-1).contiguous()
    table = shell.table
    return rt.RadenBrdf(
        shell.diffuse,
        ReflectanceTable(values, table.first_deg, table.step_deg, table.pieces),
        diffuse_gain=0.5,
        specular_gain=2.0,
        layout=shell.layout,
    )


@pytest.mark.parametrize("form", ["runtime", "fit"])
def test_another_shell_in_the_same_file(exported: Callable, shell: rt.RadenBrdf, form: str) -> None:
    file = exported(shell, form=form).path
    other = other_shell(shell)
    maps = unit_maps((1, 16, 16))
    extra = {
        "exposure": torch.tensor(0.25),
        "irradiance": torch.tensor([1.0, 2.0, 3.0]).view(1, 3, 1, 1),
        "mask": torch.full((1, 1, 1, 1), 0.5),
    }
    with torch.no_grad():
        if form == "runtime":
            wanted = other(*maps.values())
            extra |= {"table": other.runtime_table()}
        else:
            wanted = fit_form(other, maps)
            gains = {"diffuse_gain": torch.tensor(0.5), "specular_gain": torch.tensor(2.0)}
            extra |= {"table": other.table.values.detach(), **gains}
    output = run(file, maps | extra)
    cosine = (maps["normal"] * maps["light"]).sum(1, keepdim=True).clamp(min=0)
    wanted = wanted * extra["irradiance"] * cosine * 0.25 * 0.5
    torch.testing.assert_close(output, wanted, rtol=1e-5, atol=1e-5)


def test_a_table_of_another_shape_is_refused(exported: Callable, shell: rt.RadenBrdf) -> None:
    path = exported(shell).path
    table = np.zeros((3, 4, 5, 3), np.float32)
    words = rf"table: expected shape \[{shell.layout.shape[0]}, .*, 3\], got \[3, 4, 5, 3\]"
    with pytest.raises(InputError, match=words) as refused:
        ShaderSession(path, parameters={"table": table})
    assert "\n" not in str(refused.value)
    with pytest.raises(InputError, match="parameters: expected table, got 'diffuse_gain'"):
        ShaderSession(path, parameters={"diffuse_gain": 2.0})
    with pytest.raises(InputError, match=words):
        fix_parameters(onnx.load(path), {"table": table})
    with pytest.raises(Exception, match="invalid dimensions for input: table"):
        run(path, unit_maps((1, 2, 2)) | {"table": torch.from_numpy(table)})


def test_a_session_shows_another_shell(exported: Callable, shell: rt.RadenBrdf) -> None:
    maps = {k: v.numpy() for k, v in unit_maps((1, 16, 16)).items()}
    other = other_shell(shell)
    with torch.no_grad():
        table = other.runtime_table().numpy()
        wanted = other(*(torch.from_numpy(m) for m in maps.values())).numpy()
    session = ShaderSession(
        exported(shell, output="brdf").path, threads=1, parameters={"table": table}
    )
    again = pickle.loads(pickle.dumps(session))
    for each in (session, again):
        np.testing.assert_allclose(each.run(**maps), wanted, atol=SHARE * wanted.max())


def fit_form(model: rt.RadenBrdf, maps: dict[str, torch.Tensor]) -> torch.Tensor:
    """Eq. (2) itself by angles, cut at the horizon."""
    normal, light, view = maps.values()
    above = ((normal * light).sum(1, keepdim=True) > 0) & ((normal * view).sum(1, keepdim=True) > 0)
    return model.fit_form(*rt.raden_angles(*maps.values())) * above


@pytest.mark.parametrize("of", ["shell", "matt", "baked"])
def test_the_fit_form(
    exported: Callable, request: pytest.FixtureRequest, matt: rt.RadenBrdf, of: str
) -> None:
    """The paper's form of every kind of model: a plain table, none, and one that is cut finer."""
    model = baked(matt) if of == "baked" else request.getfixturevalue(of)
    maps = unit_maps((1, 64, 64))
    with torch.no_grad():
        wanted = fit_form(model, maps)
    made = exported(model, output="brdf", form="fit")
    assert made.report.runtimes[0].status == "same picture"
    assert (run(made.path, maps) - wanted).abs().max() <= SHARE * wanted.max()
    assert verify_onnx(made.path).form == "fit"


def test_a_picture_like_shade(exported: Callable, shell: rt.RadenBrdf) -> None:
    """The scene profile is `rt.shade`: same sphere, same lights, same picture."""
    ball = sphere(64, camera=(1.0, 2.0, 5.0), samples=1)
    lights = [
        rt.DirectionalLight((1.0, 1.0, 2.0), (3.0, 2.0, 1.0)),
        rt.PointLight((-2.0, 1.0, 3.0), (9.0, 9.0, 12.0)),
    ]
    with torch.no_grad():
        wanted = rt.shade(shell, ball, lights)
    inputs = {
        "normal": ball.normal,
        "position": ball.position,
        "camera": torch.tensor([[1.0, 2.0, 5.0]]),
        "light": torch.tensor([[1.0, 1.0, 2.0, 0.0], [-2.0, 1.0, 3.0, 1.0]]),
        "light_colour": torch.tensor([[3.0, 2.0, 1.0], [9.0, 9.0, 12.0]]),
        "mask": ball.mask,
    }
    output = run(exported(shell, profile="scene").path, inputs)
    assert wanted.max() > 0.1
    assert (output - wanted).abs().max() <= SHARE * wanted.max()


@pytest.mark.slow
def test_a_real_material(exported: Callable, shared: Path) -> None:
    measurement = rt.load_measurement(shared / "data/measured_brdf/pearl-paint.csv")
    made = exported(rt.fit(measurement).model, output="brdf")
    assert made.report.runtimes[0].status == "same picture"
    assert made.report.peak > 0.1


def baked(matt: rt.RadenBrdf) -> rt.RadenBrdf:
    """A model of a table whose cells are cut into pieces."""
    pieces = ((1, 4, 2), (1, 2, 3, 1, 2, 1, 1, 5, 1), (1, 1, 2, 3, 1, 1))
    nodes = [1 + sum(cuts) for cuts in pieces]
    values = torch.rand(*nodes, 3, generator=torch.Generator().manual_seed(0))
    table = ReflectanceTable(values, (0.0, -60.0, -60.0), (20.0, 20.0, 20.0), pieces)
    return rt.RadenBrdf(matt.diffuse, table, specular_gain=0.9)


def test_a_baked_table(exported: Callable, matt: rt.RadenBrdf) -> None:
    made = exported(baked(matt))
    assert made.report.runtimes[0].status == "same picture"
    assert "incidence 0 to 60 deg" in metadata(onnx.load(made.path))["valid_range"]
    assert verify_onnx(made.path).runtimes[0].status == "same picture"


@pytest.mark.parametrize("shape", [(3, 4, 6), (8, 9, 20)])
def test_tables_of_any_size(
    exported: Callable, shell: rt.RadenBrdf, shape: tuple[int, int, int]
) -> None:
    """Even and odd numbers of nodes, and few of them."""
    model = copy.deepcopy(shell)
    model.layout = RuntimeLayout(shape, (0.05, 3.0))
    assert exported(model, output="brdf").report.runtimes[0].status == "same picture"


def test_verify_needs_the_file_alone(exported: Callable, shell: rt.RadenBrdf) -> None:
    report = verify_onnx(exported(shell, profile="gbuffer").path)
    names = [r.name for r in report.runtimes]
    others = ["OpenVINO", "OpenCV dnn", "onnxruntime-node", "onnxruntime-web"]
    assert names == ["onnxruntime", *others]
    for result in report.runtimes:
        assert result.status == "same picture" or (result.status == "skipped" and result.reason)
    assert "same picture" in str(report)


def test_exporting_says_nothing(
    matt: rt.RadenBrdf, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    report = rt.export_onnx(matt.double(), tmp_path / "matt.onnx", output="brdf", opset=20)
    matt.float()
    assert report.opset == 20
    assert capfd.readouterr() == ("", "")


def test_the_axes_are_exact(exported: Callable, shell: rt.RadenBrdf) -> None:
    """L, N and V along axes, below the horizon, zero, or not finite: no NaN, and 0 where due."""
    up, down, nothing = [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0]
    bad = [float("nan"), 0.0, 1.0]
    rows = [(up, up, up), (up, down, up), (up, up, down), (nothing, up, up), (up, bad, up)]
    maps = torch.tensor(rows).permute(1, 2, 0)[:, None, :, None].contiguous()
    inputs = dict(zip(("normal", "light", "view"), maps, strict=True))
    output = run(exported(shell, profile="gbuffer").path, inputs).numpy()
    assert np.isfinite(output).all()
    assert (output[..., 0] > 0.1).all()
    assert (output[..., 1:] == 0).all()
