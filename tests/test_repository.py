"""The files that other programs read of the repository: they parse, and name what is there."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import pytest

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
