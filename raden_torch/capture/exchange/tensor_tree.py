"""Radiance's tensor tree: the text of its leaves, and the directions of its axes.

`{ a b … }` holds 2^(k·rank) values of one grid, the first axis slowest; `{ {…} {…} … }` holds
2^rank halves, of which bit d of the place says which half of axis d. All axes run from 0 to 1: of
rank 4 two for the incident and two for the outgoing direction, each pair a unit square onto which
Shirley and Chiu (1997) map the disk of projected directions; of rank 3 one for the incident polar
angle, (1 − sin θ)/2 below ½ (the other half is not used), with the light on the side of −x.

Source: Radiance's bsdf_t.c and disk2square.c.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats, Ints
from raden_torch.errors import InputError
from raden_torch.measurement.text_file import shown

MAX_LEAVES = 5_000_000
_WIDEST = 1 / 8
_DEEPEST = 16
_RIM = 1 - 1e-9


def leaves(path: Path, text: str, rank: int) -> tuple[Floats, Floats]:
    """Middles `[M, rank]` and values `[M]` of the leaves, none wider than an eighth.

    Raises:
        InputError: braces or numbers that do not fit.
    """
    tokens = re.findall(r"[{}]|[^\s,{}]+", text)
    middles: list[Floats] = []
    values: list[Floats] = []
    total = 0
    # what is open: the corner and width of each node, and how many of its halves are done
    stack: list[tuple[Floats, float, int]] = []
    corner, width, at = np.zeros(rank), 1.0, 0
    while True:
        if at >= len(tokens) or tokens[at] != "{":
            got = shown(tokens[at]) if at < len(tokens) else "the end: it is truncated"
            raise InputError(f"{path}: tensor tree: expected '{{', got {got}")
        at += 1
        if at < len(tokens) and tokens[at] == "{":
            if len(stack) == _DEEPEST:
                raise InputError(f"{path}: tensor tree: expected at most {_DEEPEST} levels")
            stack.append((corner, width, 0))
            width /= 2
            continue
        end = at
        while end < len(tokens) and tokens[end] not in "{}":
            end += 1
        grid = _grid(path, tokens[at:end], rank)
        total += max(len(grid), round((width / _WIDEST) ** rank))
        if total > MAX_LEAVES:
            raise InputError(f"{path}: tensor tree: expected at most {MAX_LEAVES} leaves, got more")
        places, grid = _split(grid, width, rank)
        side = round(len(grid) ** (1 / rank))
        middles.append(corner + width * (places + 0.5) / side)
        values.append(grid)
        at = end
        while True:  # close what is full
            if at >= len(tokens) or tokens[at] != "}":
                got = shown(tokens[at]) if at < len(tokens) else "the end: it is truncated"
                raise InputError(f"{path}: tensor tree: expected '}}', got {got}")
            at += 1
            if not stack:
                if at < len(tokens):
                    raise InputError(f"{path}: tensor tree: expected its end, got {tokens[at]!r}")
                return _used(np.concatenate(middles), np.concatenate(values))
            parent, whole, done = stack.pop()
            if done + 1 < 1 << rank:
                stack.append((parent, whole, done + 1))
                half = np.array([(done + 1) >> d & 1 for d in range(rank)])
                corner, width = parent + half * whole / 2, whole / 2
                break


def _grid(path: Path, words: list[str], rank: int) -> Floats:
    """`[2^(k·rank)]` values."""
    try:
        values = np.array(words, np.float64)
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all():
        raise InputError(f"{path}: tensor tree: expected numbers, got {shown(' '.join(words[:4]))}")
    levels = (len(values).bit_length() - 1) / rank
    if not len(values) or len(values) != 1 << (len(values).bit_length() - 1) or levels % 1:
        raise InputError(
            f"{path}: tensor tree: expected 1, {1 << rank}, {1 << 2 * rank}, … numbers between "
            f"braces, got {len(values)}"
        )
    return values


def _split(values: Floats, width: float, rank: int) -> tuple[Ints, Floats]:
    """Places `[N, rank]` in a finer grid, whose cells are at most an eighth, and their values."""
    side = round(len(values) ** (1 / rank))
    times = 1
    while width / (side * times) > _WIDEST:
        times *= 2
    places = np.indices((side * times,) * rank).reshape(rank, -1).T
    index = np.ravel_multi_index(tuple((places // times).T), (side,) * rank)
    return places, values[index]


def _used(middles: Floats, values: Floats) -> tuple[Floats, Floats]:
    if middles.shape[1] == 4:
        return middles, values
    used = middles[:, 0] < 0.5
    return middles[used], values[used]


def tree_directions(middles: Floats) -> tuple[Floats, Floats]:
    """Light and view `[3, M]` of places `[M, 3]` or `[M, 4]`."""
    outgoing = _on_disk(middles[:, -2:])
    if middles.shape[1] == 4:
        incident = -_on_disk(middles[:, :2])
    else:
        sine = 1 - 2 * middles[:, 0]
        incident = np.stack([-sine, np.zeros_like(sine)])
    return _upward(incident), _upward(outgoing)


def _on_disk(square: Floats) -> Floats:
    """`[M, 2]` in the unit square → `[2, M]` in the unit disk (Shirley & Chiu 1997)."""
    a, b = (2 * square - 1).T
    flat = abs(a) >= abs(b)
    radius = np.where(flat, a, b)
    safe = np.where(radius == 0, 1.0, radius)
    turn = np.where(flat, np.pi / 4 * b / safe, np.pi / 2 - np.pi / 4 * a / safe)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)])


def _upward(disk: Floats) -> Floats:
    x, y = disk * np.minimum(1, _RIM / np.maximum(np.hypot(*disk), 1e-30))
    return np.stack([x, y, np.sqrt(1 - x**2 - y**2)])
