"""Every notebook runs from top to bottom, is committed clean, and holds no library code."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_committed_clean(path: Path) -> None:
    assert path.stat().st_size < 40_000  # a shown model alone is 1.4 MB
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type != "code":
            continue
        assert cell.outputs == []
        assert cell.execution_count is None
        for node in ast.walk(ast.parse(cell.source)):
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                assert node.end_lineno - node.lineno < 3, (
                    f"{node.name}: it belongs into the library"
                )


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_runs(path: Path, tmp_path: Path) -> None:
    script = (
        "import nbformat, nbclient, sys\n"
        "n = nbformat.read(sys.argv[1], as_version=4)\n"
        "nbclient.NotebookClient(n, timeout=900, kernel_name='python3').execute()\n"
        "nbformat.write(n, sys.argv[2])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(path), str(tmp_path / "run.ipynb")],
        capture_output=True,
        text=True,
        timeout=1800,
        cwd=tmp_path,
        env=os.environ | {"MPLBACKEND": "module://matplotlib_inline.backend_inline"},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    run = nbformat.read(tmp_path / "run.ipynb", as_version=4)
    pictures = [
        output
        for cell in run.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    assert pictures
