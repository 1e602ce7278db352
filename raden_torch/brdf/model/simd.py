"""Which form of the model runs here: the fused kernel by an instruction set, the Triton kernels on
a GPU, or eager torch?

The environment variable RADEN_TORCH_SIMD chooses: avx512, avx2, portable, or off (eager on every
device).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import PackageNotFoundError, version

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
LEAST_TRITON = (3, 9)
LEAST_CAPABILITY = (8, 0)
"""Of a GPU: what the Triton kernels are compiled for in the tests begins here."""


def _level_asked_for() -> str | None:
    asked = os.environ.get(VARIABLE, "")
    choices = (*LEVELS, OFF)
    if asked and asked not in choices:
        raise InputError(
            f"{VARIABLE}: expected one of {', '.join(choices)} on this machine, got {asked}"
        )
    return asked or None


_asked = _level_asked_for()
"""None takes the fastest."""


def level() -> str:
    """The instruction set in use, or "off"."""
    return _asked or (LEVELS[-1] if LEVELS else OFF)


def triton_runs(device: str) -> bool:
    """Whether the Triton kernels run on this CUDA device, named as torch does."""
    return _asked != OFF and _can_run_triton(device)


@cache
def _has_triton() -> bool:
    """In a version that the kernels are tested with."""
    try:
        parts = version("triton").split(".")
    except PackageNotFoundError:
        return False
    return tuple(int(part) for part in parts[:2]) >= LEAST_TRITON


def _can_run_triton(device: str) -> bool:
    return (
        _has_triton()
        and torch.version.hip is None
        and torch.cuda.get_device_capability(device) >= LEAST_CAPABILITY
    )


# what torch.compiler.assume_constant_result does; that loads the compiler, which takes seconds
_can_run_triton._dynamo_marked_constant = True  # type: ignore[attr-defined]


@contextmanager
def using(name: str) -> Iterator[None]:
    """Within the block, take this instruction set; "off" takes the eager form."""
    global _asked
    if name not in (*LEVELS, OFF):
        raise InputError(
            f"kernel: expected one of {', '.join((*LEVELS, OFF))} on this machine, got {name}"
        )
    before, _asked = _asked, name
    try:
        yield
    finally:
        _asked = before


def system_report() -> str:
    """Which form of the model runs here, one fact a line."""
    if level() != OFF:
        form = f"fused kernel, {level()} (this machine has {', '.join(LEVELS)})"
    elif LEVELS:
        form = f"eager torch: {VARIABLE}={OFF}"
    else:
        form = "eager torch: the kernel was not built (no C++ compiler at install time?)"
    return "\n".join(
        (
            f"evaluation: {form}",
            *(f"on cuda:{k}: {_gpu_form(f'cuda:{k}')}" for k in range(torch.cuda.device_count())),
            "in float64 and on other devices: eager torch",
            f"threads: {torch.get_num_threads()}",
            f"torch: {torch.__version__}",
        )
    )


def _gpu_form(device: str) -> str:
    name = torch.cuda.get_device_name(device)
    if triton_runs(device):
        return f"Triton kernels ({name})"
    if _asked == OFF:
        return f"eager torch: {VARIABLE}={OFF} ({name})"
    if not _has_triton():
        least = ".".join(map(str, LEAST_TRITON))
        return f"eager torch: triton {least} is not installed ({name})"
    least = ".".join(map(str, LEAST_CAPABILITY))
    return f"eager torch: the Triton kernels need CUDA and compute capability {least} ({name})"
