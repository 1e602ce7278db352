"""docs/export.md is what an application's developer has: its code runs as it stands."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import raden_torch as rt

PAGE = Path(__file__).resolve().parents[2] / "docs" / "export.md"


def test_the_examples_run(exported: Callable, shell: rt.RadenBrdf, tmp_path: Path) -> None:
    (tmp_path / "shell.onnx").write_bytes(exported(shell, profile="gbuffer").path.read_bytes())
    alone, with_us = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), flags=re.DOTALL)
    absent = "import sys; assert not {'torch', 'raden_torch', 'onnx'} & set(sys.modules)\n"
    same = "assert np.allclose(image * 2, radiance, atol=1e-5) and radiance.max() > 0.5\n"
    (tmp_path / "example.py").write_text(alone + absent + with_us + same, "utf-8")
    done = subprocess.run(
        [sys.executable, "-W", "error", "example.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "(3, 256, 256) yakogai"
    assert done.stderr == ""
