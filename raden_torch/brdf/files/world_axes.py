"""Which way a renderer's world points; ours has y up, right-handed."""

from __future__ import annotations

from typing import Literal, get_args

from raden_torch.errors import InputError

World = Literal["y-up", "z-up", "unreal"]

TO_Y_UP: dict[str, tuple[tuple[int, int, int], ...]] = {
    "y-up": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    # x right, y away, z up: Blender, 3ds Max
    "z-up": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    # x away, y right, z up, left-handed: Unreal
    "unreal": ((0, 1, 0), (0, 0, 1), (-1, 0, 0)),
}
"""The rows are our x, y and z in the renderer's."""


def one_of(name: str, value: str, kinds: object) -> None:
    """Raise InputError unless a value is one of a Literal's."""
    if value not in get_args(kinds):
        raise InputError(f"{name}: expected {', '.join(get_args(kinds))}, got {value!r}")


def in_y_up(vector: tuple[float, float, float], world: World) -> tuple[float, float, float]:
    """A vector of a renderer's world in the world with y up, exactly."""
    x, y, z = (sum(m * v for m, v in zip(row, vector, strict=True)) for row in TO_Y_UP[world])
    return x, y, z
