"""The files that other programs read of the repository: they parse, and name what is there."""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

import raden_torch

PROJECT = Path(__file__).parents[1]
FILES = sorted(
    str(path.relative_to(PROJECT))
    for pattern in (".pre-commit-config.yaml", ".github/**/*.yml")
    for path in PROJECT.glob(pattern)
)


def parsed(name: str) -> Any:
    yaml = pytest.importorskip("yaml", reason="PyYAML, of the extra `dev`, is not installed")
    return yaml.safe_load((PROJECT / name).read_text("utf-8"))


@pytest.mark.parametrize("name", FILES)
def test_the_yaml_files_parse(name: str) -> None:
    assert isinstance(parsed(name), dict)


def test_the_hooks_are_what_make_lint_runs() -> None:
    hooks = parsed(".pre-commit-config.yaml")["repos"][0]["hooks"]
    makefile = (PROJECT / "Makefile").read_text("utf-8")
    lint = re.findall(r"^\t\$\(BIN\)/([\w-]+(?: (?:check|format))?)", makefile, re.MULTILINE)
    tools = [re.match(r"\.venv/bin/([\w-]+(?: (?:check|format))?)", h["entry"])[1] for h in hooks]
    assert {hook["language"] for hook in hooks} == {"system"}
    assert len(tools) == 4
    assert set(tools) <= set(lint)


def test_ci_runs_the_projects_own_script() -> None:
    steps = parsed(".github/workflows/ci.yml")["jobs"]["test"]["steps"]
    assert [step["run"] for step in steps if "run" in step] == [".ci/run"]
    assert os.access(PROJECT / ".ci/run", os.X_OK)


@pytest.mark.parametrize("name", ["fault", "wish"])
def test_the_forms_have_what_github_asks_for(name: str) -> None:
    """Rationale: GitHub leaves out a form without name, description or body, and says nothing."""
    form = parsed(f".github/ISSUE_TEMPLATE/{name}.yml")
    assert form["name"]
    assert form["description"]
    ids = [field["id"] for field in form["body"]]
    assert len(ids) == len(set(ids))
    assert all(field["attributes"]["label"] for field in form["body"])


def test_contributing_names_files_that_are_there() -> None:
    text = (PROJECT / "CONTRIBUTING.md").read_text("utf-8")
    named = re.findall(r"`((?:[\w.]+/)+[\w.]*\w\.(?:py|md|h|yml))`", text)
    missing = [
        name
        for name in named
        if not any((PROJECT / r / name).exists() for r in ("", "raden_torch"))
    ]
    assert len(named) > 10
    assert not missing


def test_one_version_stands_everywhere() -> None:
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text("utf-8"))["project"]
    assert raden_torch.__version__ == project["version"]
    citation = parsed("CITATION.cff")
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])
    assert f"## {project['version']} " in (PROJECT / "CHANGELOG.md").read_text("utf-8")


def test_wheels_are_of_the_pythons_that_are_declared() -> None:
    """Rationale: the stable ABI's wheel serves its first Python and all later ones."""
    pyproject = tomllib.loads((PROJECT / "pyproject.toml").read_text("utf-8"))
    wheels = pyproject["tool"]["cibuildwheel"]
    stable = wheels["config-settings"]["wheel.py-api"]
    built = [name.partition("-")[0] for name in wheels["build"]]
    named = re.findall(r":: 3\.(\d+)", "\n".join(pyproject["project"]["classifiers"]))
    assert built == [f"cp3{minor}" for minor in named if f"cp3{minor}" <= stable]
    assert pyproject["project"]["requires-python"] == f">=3.{named[0]}"
    assert "STABLE_ABI" in (PROJECT / "kernel/CMakeLists.txt").read_text("utf-8")
    assert (PROJECT / wheels["test-command"].split("{project}/")[1]).is_file()
