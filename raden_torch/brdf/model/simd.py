"""Which form of the model runs here: the fused kernel by an instruction set, or eager torch?

The environment variable RADEN_TORCH_SIMD chooses: avx512, avx2, portable, or off (eager).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from raden_torch.errors import InputError

try:
    from raden_torch.brdf import _kernel  # type: ignore[attr-defined, unused-ignore]

    LEVELS: tuple[str, ...] = tuple(_kernel.levels())
    """The instruction sets that this machine can run, the fastest last; empty if not built."""
except ImportError:
    LEVELS = ()

OFF = "off"
VARIABLE = "RADEN_TORCH_SIMD"


def _level_asked_for() -> str:
    asked = os.environ.get(VARIABLE, "")
    choices = (*LEVELS, OFF)
    if asked and asked not in choices:
        raise InputError(
            f"{VARIABLE}: expected one of {', '.join(choices)} on this machine, got {asked}"
        )
    return asked or (LEVELS[-1] if LEVELS else OFF)


_level = _level_asked_for()


def level() -> str:
    """The instruction set in use, or "off"."""
    return _level


@contextmanager
def using(name: str) -> Iterator[None]:
    """Within the block, take this instruction set; "off" takes the eager form."""
    global _level
    if name not in (*LEVELS, OFF):
        raise InputError(
            f"kernel: expected one of {', '.join((*LEVELS, OFF))} on this machine, got {name}"
        )
    before, _level = _level, name
    try:
        yield
    finally:
        _level = before


def system_report() -> str:
    """Which form of the model runs here, one fact a line."""
    if _level != OFF:
        form = f"fused kernel, {_level} (this machine has {', '.join(LEVELS)})"
    elif LEVELS:
        form = f"eager torch: {VARIABLE}={OFF}"
    else:
        form = "eager torch: the kernel was not built (no C++ compiler at install time?)"
    return "\n".join(
        (
            f"evaluation: {form}",
            "in float64 and on other devices: eager torch",
            f"threads: {torch.get_num_threads()}",
            f"torch: {torch.__version__}",
        )
    )
