"""What is installed is what is used: the core alone does the main job; an extra is asked for."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import raden_torch
from raden_torch.errors import InputError
from raden_torch.packages import EXTRAS, MissingPackageError, require

PACKAGE = Path(raden_torch.__file__).parent
PROJECT = PACKAGE.parent
MODULES = {module: package for extra in EXTRAS.values() for module, package in extra.items()}
CORE = {"torch", "kornia", "numpy", "scipy", "threadpoolctl", "safetensors", "msgspec"}
CORE |= {"cyclopts", "rich"}

WORKS = [
    "--help",
    "--version",
    "capture brdf --help",
    "capture simulate --help",
    "catalogue find --help",
    "scan --help",
    "info --system",
    "info {folder}/shell.csv",
    "info {shell} --against {folder}/shell.csv",
    "merge {folder}/shell.csv {folder}/shell.csv -o {folder}/both.csv",
]
ASKS = {  # a command: what needs the extra, and the extra
    "render {shell} -o {folder}/a.jpg": ("pictures", "images"),
    "render {shell} -o {folder}/b.exr": ("pictures", "images"),
    "info {folder}/a.png": ("images", "images"),
    "info {folder}/a.exr": ("OpenEXR files", "images"),
    "relight {folder}/a.png --normals {folder}/a.exr --model {shell} -o {folder}/b.png "
    "--light 1,1,2": ("OpenEXR files", "images"),
    "fit {folder}/bands.csv -o {folder}/b.safetensors": ("colours of spectral bands", "spectral"),
    "plot {folder}/shell.csv -o {folder}/b.png": ("graphs", "plots"),
    "bench --out {folder}/bench": ("benchmarks", "plots"),
    "capture lights {folder}/a.png -o {folder}/b.json": ("photographs", "photo"),
    "info {folder}/lamps.json": ("photographs", "photo"),
    "scan --simulate --readings 20 -o {folder}/b.csv": ("simulated rigs", "spectrometer"),
    "export {shell} -o {folder}/b.onnx": ("exported shaders", "export"),
    "info {folder}/a.onnx": ("ONNX files", "export"),
    "capture simulate -o {folder}/photographs": ("simulated photographs", "simulate"),
    "catalogue find {folder} --colour green": ("catalogues", "catalogue"),
    "fit {folder}/shell.csv -o {folder}/models --engine dask --scheduler tcp://127.0.0.1:9": (
        "clusters",
        "cluster",
    ),
    "info {folder}/a.xls": ("workbooks of the RT-300S", "xls"),
    "info {folder}/a.dng": ("camera raw files", "raw"),
    "info {folder}/a.heic": ("HEIC pictures", "heif"),
    "demo --out {folder}/demo": ("the demo's pictures", "images,plots,export"),
}


def built_wheel(folder: Path) -> Path:
    """The project's own wheel, without the kernel."""
    build = [sys.executable, "-m", "pip", "wheel", str(PROJECT), "-w", str(folder), "--no-deps"]
    build += ["--no-build-isolation", "--no-index", "--config-settings", "wheel.cmake=false"]
    done = subprocess.run(build, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return next(folder.glob("*.whl"))


def required(names: set[str]) -> set[str]:
    """Distributions and all that they require, by name."""
    found: set[str] = set()
    while names:
        name = names.pop()
        found.add(name)
        wanted = map(Requirement, metadata.requires(name) or ())
        needed = {r.name for r in wanted if r.marker is None or r.marker.evaluate({"extra": ""})}
        names |= {canonicalize_name(one) for one in needed} - found
    return found


def python_with_the_wheel(folder: Path) -> Path:
    """An environment of the wheel and what the core requires, linked from this environment."""
    venv.create(folder / "env", with_pip=False, symlinks=True)
    place = {"base": str(folder / "env"), "platbase": str(folder / "env")}
    site = Path(sysconfig.get_path("purelib", vars=place))
    with zipfile.ZipFile(built_wheel(folder)) as wheel:
        wheel.extractall(site)
    for name in required(set(CORE)):
        files = metadata.distribution(name).files or []
        for top in {file.parts[0] for file in files} - {"..", "__pycache__"}:
            if not (site / top).exists():
                (site / top).symlink_to(metadata.distribution(name).locate_file(top))
    return Path(sysconfig.get_path("scripts", vars=place)) / "python"


@pytest.fixture(scope="module", params=["hook", pytest.param("wheel", marks=pytest.mark.slow)])
def core(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, Any]]:
    """What happens in a process that has the core alone: here, where the rest is refused, and in
    an environment with the project's wheel and nothing else."""
    folder = tmp_path_factory.mktemp("core")
    (folder / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    (folder / "a.dng").write_bytes(b"II*\0" + bytes(100))
    (folder / "a.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(100))
    (folder / "a.exr").write_bytes(b"\x76\x2f\x31\x01" + bytes(100))
    (folder / "a.onnx").write_bytes(b"\x08\x08\x12\x00")
    (folder / "a.xls").write_bytes(bytes.fromhex("d0cf11e0a1b11ae1") + bytes(100))
    (folder / "lamps.json").write_text('{"format": "raden capture", "kind": "lights"}')
    raden_torch.simulate_specimen("yakogai", step_deg=35, spectral=True).save(folder / "bands.csv")
    names = {"folder": str(folder), "shell": str(folder / "shell.safetensors")}
    commands = [[a.format(**names) for a in line.split()] for line in (*WORKS, *ASKS)]
    if request.param == "wheel":
        for needed in ("pip", "scikit-build-core"):
            try:  # not imported: with pip in this process, setuptools and torch.compile fail
                metadata.distribution(needed)
            except metadata.PackageNotFoundError:
                pytest.skip(f"the wheel is built by {needed}: not installed here")
        python, refused = python_with_the_wheel(folder), set()
    else:
        python, refused = Path(sys.executable), {*MODULES, "drjit", "onnx_ir", "openvino"}
    done = subprocess.run(
        [str(python), str(Path(__file__).with_name("core_only.py")), str(folder), *refused],
        input=json.dumps(commands),
        capture_output=True,
        text=True,
        timeout=300,
        env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (request.param == "wheel") == Path(found["file"]).is_relative_to(folder)
    return folder, found


def test_the_core_fits_saves_loads_and_shades(core: tuple[Path, dict[str, Any]]) -> None:
    _, found = core
    assert found["errors"]["fit form"] < 1e-5  # the reading itself, at a node
    assert found["errors"]["shade"] < 0.02  # the runtime table beside it, of a noisy measurement
    assert found["errors"]["read back"] == 0
    assert found["imported"] == []


def test_commands_that_need_no_extra_work(core: tuple[Path, dict[str, Any]]) -> None:
    for command, ran in zip(WORKS, core[1]["commands"], strict=False):
        assert ran["code"] == 0, (command, ran["stderr"])


@pytest.mark.parametrize("command", ASKS)
def test_a_command_says_what_to_install(core: tuple[Path, dict[str, Any]], command: str) -> None:
    folder, found = core
    work, extras = ASKS[command]
    ran = found["commands"][len(WORKS) + list(ASKS).index(command)]
    assert ran["code"] == 2, ran["stderr"]
    assert ran["stderr"].count("\n") == 1
    packages = dict.fromkeys(p for extra in extras.split(",") for p in EXTRAS[extra].values())
    line = f"{work} need {', '.join(packages)}, not installed here: "
    assert ran["stderr"].endswith(f"{line}pip install 'raden_torch[{extras}]'\n")
    assert not [*folder.glob("b.*"), *folder.glob("demo"), *folder.glob("bench")]


def test_only_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("PIL", "onnx"):
        monkeypatch.setitem(sys.modules, module, None)
    require("graphs", "plots")
    expected = (
        "shaders need pillow, onnx, not installed here: pip install 'raden_torch[photo,export]'"
    )
    with pytest.raises(MissingPackageError, match=re.escape(expected)) as caught:
        require("shaders", "photo", "plots", "export")
    assert str(caught.value).endswith("[photo,export]'")
    assert isinstance(caught.value, InputError)
    assert isinstance(caught.value, ImportError)


def test_the_extras_are_those_of_pyproject() -> None:
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]

    def packages(requirements: list[str]) -> set[str]:
        found = set()
        for requirement in requirements:
            inner = re.fullmatch(r"raden_torch\[(.+)\]", requirement)
            if inner:
                found |= {p for name in inner[1].split(",") for p in packages(extras[name])}
            else:
                found.add(re.split(r"[<>=;]", requirement)[0])
        return found

    assert {name: packages(extras[name]) - CORE for name in EXTRAS} == {
        name: set(modules.values()) for name, modules in EXTRAS.items()
    }
    assert packages(extras["all"]) - CORE == set(MODULES.values())
    assert packages(extras["dev"]) >= packages(extras["all"])
    assert packages(project["dependencies"]) == CORE


def imported_extras(tree: ast.AST) -> set[str]:
    """The modules of extras that are imported anywhere in the tree, types aside."""
    found: set[str] = set()
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        found |= {name.partition(".")[0] for name in names} & set(MODULES)
        found |= imported_extras(node)
    return found


def asked_for(tree: ast.AST) -> set[str]:
    """The modules of the extras that calls of `require` name."""
    calls = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "require"
    ]
    names = {a.value for call in calls for a in call.args[1:] if isinstance(a, ast.Constant)}
    return {module for name in names for module in EXTRAS[name]}


DOORS = {
    "capture/photo": "photo",
    "stereo": "photo",
    "plots": "plots",
    "catalogue": "catalogue",
}
"""Rooms that ask for all of an extra when they are entered, in their __init__.py."""
AFTER_THE_DOOR = {
    "export/constants.py",  # of whoever read the graph
    "export/trace.py",  # of export_onnx
    "info/shader_info.py",  # of onnx_file.read_graph
    "export/workers/other_python.py",  # runs in another environment
}


def test_whoever_imports_an_extra_asks_for_it() -> None:
    silent = []
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        tree = ast.parse(path.read_text("utf-8"))
        asked = asked_for(tree)
        for room, extra in DOORS.items():
            if name.startswith(f"{room}/"):
                assert 'require("' in (PACKAGE / room / "__init__.py").read_text("utf-8")
                asked |= set(EXTRAS[extra])
        missing = imported_extras(tree) - asked
        if missing and name not in AFTER_THE_DOOR:
            silent.append(f"{name}: {', '.join(missing)}")
    assert not silent


def test_no_module_imports_an_extra_at_its_top() -> None:
    """The graphs aside, whose room is entered only to draw."""
    early = []
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        top = ast.parse(path.read_text("utf-8"))
        top.body = [n for n in top.body if isinstance(n, (ast.Import, ast.ImportFrom))]
        if not name.startswith("plots/"):
            early += [f"{name}: {module}" for module in imported_extras(top)]
    assert not early


@pytest.mark.parametrize("observer", ["CIE 1931 2 deg", "CIE 1964 10 deg"])
@pytest.mark.parametrize("white", ["A", "C", "D50", "D55", "D65", "D75", "E"])
def test_the_constants_are_those_of_colour_science(white: str, observer: str) -> None:
    import colour

    from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix

    name = {"2 deg": "CIE 1931 2 Degree", "10 deg": "CIE 1964 10 Degree"}[observer[9:]]
    theirs = colour.XYZ_to_RGB(
        np.eye(3),
        "sRGB",
        illuminant=colour.CCS_ILLUMINANTS[f"{name} Standard Observer"][white],
        chromatic_adaptation_transform="Bradford",
        apply_cctf_encoding=False,
    )
    np.testing.assert_allclose(xyz_to_rgb_matrix(white, observer), theirs.T, atol=1e-14)


def test_the_primaries_matrix_is_that_of_colour_science() -> None:
    from colour.models import normalised_primary_matrix

    from raden_torch.colorimetry import primary_matrix

    adobe = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290)
    theirs = normalised_primary_matrix(np.reshape(adobe[:6], (3, 2)), np.array(adobe[6:]))
    np.testing.assert_allclose(primary_matrix(adobe), theirs, atol=1e-14)


def test_the_simulated_shells_colours_are_those_of_its_bands() -> None:
    geometries = [[20, 25, 0], [10, -30, 15], [45, 60, -20]]
    xyz = raden_torch.simulate_specimen("yakogai", geometries_deg=geometries)
    bands = raden_torch.simulate_specimen("yakogai", geometries_deg=geometries, spectral=True)
    np.testing.assert_allclose(xyz.values, bands.as_xyz().values, rtol=1e-11)
