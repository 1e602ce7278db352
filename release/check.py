"""What a release has to pass beside `make test`: packages of a clean checkout, elsewhere.

    python release/check.py contents    # sdist and wheel of HEAD: what is in them, and how large
    python release/check.py compilers   # the sdist installed with a compiler, and without one
    python release/check.py extras      # every extra alone: imports, and its smallest command
    python release/check.py lowest      # the lowest versions that pyproject.toml allows, and tests
    python release/check.py typed       # mypy --strict on consumer.py, which uses the wheel
    python release/check.py sbom        # all that `raden_torch[all]` installs, as CycloneDX
    python release/check.py newer PYTHON…   # the wheel and the core of tests under other Pythons

It needs git, `build` and `uv` of the Python that runs it (`pip install build uv`), a network and
up to 10 GB and ten minutes each, under --work; CI does not run it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Sequence
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
CORE_TESTS = (
    "tests/test_geometry.py",
    "tests/test_api_snapshot.py",
    "tests/physics",
    "tests/brdf/model/test_model.py",
    "tests/brdf/model/test_kernel.py",
    "tests/brdf/shading/test_shade.py",
    "tests/brdf/fitting/test_fit.py",
    "tests/measurement/test_native_csv.py",
    "tests/measurement/test_merge.py",
    "tests/reflectance/test_isotropic.py",
)
MOST_BYTES = {"wheel": 2_000_000, "sdist": 2_000_000}

SMALLEST = {
    "images": "raden render shell.safetensors --size 32 -o a.png",
    "spectral": "raden fit bands.csv -o bands.safetensors",
    "plots": "raden plot shell.csv --figure 5 -o graphs.svg",
    "photo": "raden capture segment a.png --shells 1 -o map.png",
    "spectrometer": "raden scan --simulate --plan random --readings 30 -o scan.csv",
    "export": "raden export shell.safetensors -o shell.onnx",
    "simulate": "raden capture simulate --lamps 3 --width 300 -o photographs",
    "xls": "raden info shell.csv",
    "raw": "raden info a.png",
    "heif": "raden info a.png",
    "icc": "raden info a.png",
    "catalogue": "raden catalogue add shells shell.csv",
    "cluster": "raden fit shell.csv -o models --interpolation trilinear",
}
"""A command that needs the extra, of files that `make_inputs` writes."""


class Work:
    """The folder of a run: a clean checkout, its packages, and environments."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.checkout = folder / "checkout"
        self.packages = folder / "packages"

    def build(self) -> tuple[Path, Path]:
        """Sdist and wheel of HEAD, the wheel built from the sdist."""
        for old in (self.checkout, self.packages):
            shutil.rmtree(old, ignore_errors=True)
        run("git", "clone", "-q", str(PROJECT), str(self.checkout))
        run(sys.executable, "-m", "build", "-o", str(self.packages), str(self.checkout))
        return next(self.packages.glob("*.tar.gz")), next(self.packages.glob("*.whl"))

    def environment(self, name: str, python: str = sys.executable) -> Path:
        """The Python of an empty environment."""
        place = self.folder / name
        shutil.rmtree(place, ignore_errors=True)
        uv("venv", "-q", "--python", python, str(place))
        return place / "bin/python"


def run(*words: str, cwd: Path | None = None, env: dict[str, str] | None = None) -> None:
    done = subprocess.run(words, cwd=cwd, env=env, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(words)}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}")
    if done.stdout.strip():
        print(done.stdout.strip().splitlines()[-1], flush=True)


def uv(*words: str, env: dict[str, str] | None = None) -> None:
    run(sys.executable, "-m", "uv", *words, env=env)


def contents(work: Work) -> None:
    """The wheel holds the package alone; the sdist what builds and tests it."""
    sdist, wheel = work.build()
    with zipfile.ZipFile(wheel) as archive:
        files = {info.filename: info.file_size for info in archive.infolist()}
    strange = [
        name
        for name in files
        if not name.startswith("raden_torch") or name.endswith((".h", ".cpp", ".pyc", ".ipynb"))
    ]
    kernels = [name for name in files if name.endswith(".so")]
    if strange or len(kernels) != 1 or "raden_torch/py.typed" not in files:
        sys.exit(f"{wheel.name}: expected one kernel and py.typed, got {kernels}, {strange}")
    with tarfile.open(sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    wanted = {
        "kernel/CMakeLists.txt",
        "pyproject.toml",
        "LICENSE",
        "tests/conftest.py",
        "README.md",
    }
    if not wanted <= held or any(name.startswith("docs/pictures") for name in held):
        sys.exit(f"{sdist.name}: expected {sorted(wanted - held)}, and no pictures")
    for kind, path in (("wheel", wheel), ("sdist", sdist)):
        size = path.stat().st_size
        if size > MOST_BYTES[kind]:
            sys.exit(f"{path.name}: expected at most {MOST_BYTES[kind]} bytes, got {size}")
        print(f"{path.name}: {size / 1e6:.2f} MB, {len(files if kind == 'wheel' else held)} files")
    whole = sum(files.values())
    print(f"{kernels[0]}: {files[kernels[0]] / 1e6:.2f} MB of {whole / 1e6:.2f} MB unpacked")


def compilers(work: Work) -> None:
    """From the sdist, as where there is no wheel for a machine."""
    sdist, _ = work.build()
    for name, more in (("with", {}), ("without", {"CC": "/nowhere/cc", "CXX": "/nowhere/c++"})):
        python = work.environment(name)
        uv(
            "pip",
            "install",
            "-q",
            "--no-cache",
            "--python",
            str(python),
            str(sdist),
            env={**os.environ, **more},
        )
        words = () if name == "with" else ("without-kernel",)
        run(str(python), str(PROJECT / "release/check_wheel.py"), *words, cwd=work.folder)


def extras(work: Work) -> None:
    """Each alone: its modules can be imported, and its smallest command runs."""
    _, wheel = work.build()
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text("utf-8"))["project"]
    made = make_inputs(work, wheel)
    for extra in (e for e in project["optional-dependencies"] if e not in ("all", "dev", "docs")):
        python = work.environment(f"extra-{extra}")
        uv(
            "pip",
            "install",
            "-q",
            "--python",
            str(python),
            f"raden_torch[{extra}] @ {wheel.as_uri()}",
        )
        listed = (
            f"from raden_torch.packages import EXTRAS; [__import__(m) for m in EXTRAS['{extra}']]"
        )
        run(str(python), "-c", listed)
        folder = work.folder / f"files-{extra}"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(made, folder)
        run(str(python), "-m", "raden_torch.cli", *SMALLEST[extra].split()[1:], cwd=folder)
        print(f"{extra}: {SMALLEST[extra]}: done", flush=True)
        shutil.rmtree(python.parents[1])


def make_inputs(work: Work, wheel: Path) -> Path:
    """What the smallest commands read, written by the package with all extras."""
    python = work.environment("inputs")
    uv("pip", "install", "-q", "--python", str(python), f"raden_torch[images] @ {wheel.as_uri()}")
    folder = work.folder / "inputs-made"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    code = (
        "import raden_torch as rt, numpy as np, cv2\n"
        "m = rt.simulate_specimen('yakogai', step_deg=35); m.save('shell.csv')\n"
        "rt.save_model(rt.fit(m, interpolation='trilinear').model, 'shell.safetensors')\n"
        "rt.simulate_specimen('yakogai', step_deg=35, spectral=True).save('bands.csv')\n"
        "p = np.full((64, 64, 3), 20, np.uint8); p[16:48, 16:48] = (60, 200, 120)\n"
        "cv2.imwrite('a.png', p)\n"
    )
    run(str(python), "-c", code, cwd=folder)
    return folder


def typed(work: Work) -> None:
    """`py.typed` is read, and the public types are enough for a strict program."""
    _, wheel = work.build()
    python = work.environment("typed")
    uv("pip", "install", "-q", "--python", str(python), str(wheel), "mypy")
    shutil.copy(PROJECT / "release/consumer.py", work.folder)
    run(str(python), "-m", "mypy", "--strict", "consumer.py", cwd=work.folder)


def sbom(work: Work) -> None:
    """A bill of materials beside the packages: names, versions and licences."""
    _, wheel = work.build()
    python = work.environment("bill")
    uv("pip", "install", "-q", "--python", str(python), f"raden_torch[all] @ {wheel.as_uri()}")
    target = work.packages / f"{wheel.name.removesuffix('.whl')}.cdx.json"
    tool = ("tool", "run", "-q", "--from", "cyclonedx-bom", "cyclonedx-py", "environment")
    uv(*tool, str(python), "--of", "JSON", "-o", str(target))
    print(f"wrote {target}")


def lowest(work: Work) -> None:
    """The core with the lowest versions allowed, and its tests; then with all extras."""
    _, wheel = work.build()
    for name, more in (("core", ()), ("all", ("--extra", "all"))):
        pins = work.folder / f"lowest-{name}.txt"
        words = ("pip", "compile", "-q", "--resolution", "lowest-direct", "-o", str(pins))
        uv(*words, *more, str(PROJECT / "pyproject.toml"))
        python = work.environment(f"lowest-{name}")
        uv("pip", "install", "-q", "--python", str(python), "-r", str(pins))
        tested(work, python, wheel, CORE_TESTS)


def newer(work: Work, pythons: Sequence[str]) -> None:
    """The wheel under other Pythons: that of the stable ABI where there is one."""
    _, wheel = work.build()
    for number, other in enumerate(pythons):
        python = work.environment(f"newer-{number}", other)
        uv("pip", "install", "-q", "--python", str(python), str(wheel))
        tested(work, python, wheel, CORE_TESTS)


def tested(work: Work, python: Path, wheel: Path, tests: Sequence[str]) -> None:
    """Install the wheel and run tests of the checkout against it, not against the checkout."""
    needs = ("pytest", "pytest-xdist", "hypothesis", "packaging")
    uv("pip", "install", "-q", "--python", str(python), *needs)
    uv("pip", "install", "-q", "--no-deps", "--python", str(python), str(wheel))
    run(str(python), str(PROJECT / "release/check_wheel.py"), cwd=work.folder)
    hidden = work.checkout / "raden_torch"
    if hidden.exists():
        hidden.rename(work.checkout / "not_imported")
    words = ("-m", "pytest", "-q", "-W", "default", "-m", "not slow", "-p", "no:cacheprovider")
    run(str(python), *words, *tests, cwd=work.checkout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    checks = {check.__name__: check for check in (contents, compilers, extras, typed, sbom, lowest)}
    parser.add_argument("check", choices=(*checks, "newer"))
    parser.add_argument("pythons", nargs="*", help="of `newer`: other Pythons")
    parser.add_argument("--work", type=Path, default=Path("release-work").resolve())
    asked = parser.parse_args()
    asked.work.mkdir(parents=True, exist_ok=True)
    work = Work(asked.work)
    if asked.check == "newer":
        newer(work, asked.pythons)
    else:
        checks[asked.check](work)


if __name__ == "__main__":
    main()
