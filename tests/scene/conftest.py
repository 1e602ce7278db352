"""A small scene file that tests change."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

PLAIN = """
[picture]
size = [96, 54]
samples = 2
[camera]
position = [1.5, 3.7, 5.6]
target = [0.05, 0.36, 0.0]
[object]
artwork = "none"
[lights.environment]
builtin = "room"
[display]
exposure = 0.0
[animation]
frames = 4
"""


@pytest.fixture
def scene_file(tmp_path: Path) -> Callable[..., Path]:
    """Writes the plain scene with (old, new) replaced, and more at its end; returns its path."""

    def write(*changes: tuple[str, str], more: str = "") -> Path:
        text = PLAIN
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "scene.toml"
        path.write_text(text + more)
        return path

    return write
