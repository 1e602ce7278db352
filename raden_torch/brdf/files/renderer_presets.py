"""How renderers store a G-buffer, by their names; docs/renderers.md says where each is from."""

from __future__ import annotations

from typing import Any

from raden_torch.errors import InputError

PRESETS: dict[str, dict[str, Any]] = {
    "arnold": {"space": "world", "world": "y-up"},
    "blender": {"space": "world", "world": "z-up", "depth": "blender"},
    "karma": {"space": "world", "world": "y-up", "depth": "karma"},
    "mitsuba": {"space": "world", "world": "y-up", "depth": "mitsuba"},
    "unreal": {"space": "world", "world": "unreal"},
    "vray": {"space": "camera", "position_space": "world", "world": "z-up"},
}
"""The attributes of `GBufferReading`."""


def preset(name: str) -> dict[str, Any]:
    """A renderer's attributes of `GBufferReading`.

    Raises:
        InputError: none of `PRESETS`.
    """
    if name not in PRESETS:
        raise InputError(f"preset: expected {', '.join(PRESETS)}, got {name!r}")
    return PRESETS[name]
