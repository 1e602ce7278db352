"""Which of Mitsuba's variants runs on this machine, and Mitsuba in it."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from typing import Any

from raden_torch.errors import InputError
from raden_torch.packages import require

SCALAR, LLVM = "scalar_rgb", "llvm_ad_rgb"
_PROBE = f"""
import mitsuba as mi
mi.set_variant("{LLVM}")
scene = mi.load_dict(mi.cornell_box())
assert mi.render(scene, spp=1).numpy().max() > 0
"""


def mitsuba(variant: str = SCALAR) -> Any:
    """Mitsuba 3 in a variant.

    Raises:
        InputError: it is not installed, or the variant does not run here.
    """
    require("simulated photographs", "simulate")
    import mitsuba as mi

    if variant not in (SCALAR, LLVM):
        raise InputError(f"Mitsuba variant: expected {SCALAR} or {LLVM}, got {variant!r}")
    if variant == LLVM and (reason := why_no_llvm()) is not None:
        raise InputError(f"Mitsuba variant {LLVM}: {reason}; {SCALAR} runs everywhere")
    if mi.variant() != variant:
        mi.set_variant(variant)
    return mi


@cache
def why_no_llvm() -> str | None:
    """What keeps the LLVM variant from running; None where nothing does.

    Asked of another process: some versions of LLVM end the process that loads them (15 and 16 on
    machines with AVX-512; 19 works, `apt-get install libllvm19`, DRJIT_LIBLLVM_PATH).
    """
    try:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE],
            capture_output=True,
            text=True,
            timeout=120,
            env=dict(os.environ),
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"LLVM could not be tried ({type(error).__name__})"
    if probe.returncode == 0:
        return None
    if probe.returncode < 0:
        return f"LLVM ends the process with signal {-probe.returncode} on this machine"
    lines = probe.stderr.strip().splitlines()
    return lines[-1][:200] if lines else f"LLVM fails with exit code {probe.returncode}"
