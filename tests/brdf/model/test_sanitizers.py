"""No access out of bounds and nothing undefined in the kernel, by a compiler's sanitizers."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from raden_torch.brdf.model import simd

ROOT = Path(__file__).parents[3]
SANITIZERS = (
    "-fsanitize=address,undefined -fno-sanitize-recover=undefined -fno-omit-frame-pointer -g1"
)


def library(name: str) -> str:
    """Where g++ keeps a run-time library; empty where it has none."""
    if shutil.which("g++") is None:
        return ""
    found = subprocess.run(
        ["g++", f"-print-file-name={name}"], capture_output=True, text=True, check=True
    ).stdout.strip()
    return found if os.path.isabs(found) else ""


@pytest.mark.slow
@pytest.mark.skipif(not simd.LEVELS, reason="the kernel was not built here")
@pytest.mark.skipif(
    not (library("libasan.so") and shutil.which("cmake") and sys.platform == "linux"),
    reason="g++ with its sanitizers and cmake are needed to build the kernel again",
)
def test_every_shape_stride_and_mask_under_the_sanitizers(tmp_path) -> None:
    environment = os.environ | {"CXX": "g++", "OMP_NUM_THREADS": "1"}
    configure = [
        *("cmake", "-S", ROOT / "kernel", "-B", tmp_path, "-DCMAKE_BUILD_TYPE=Release"),
        *(f"-DPython_EXECUTABLE={sys.executable}", f"-DCMAKE_CXX_FLAGS={SANITIZERS}"),
    ]
    for command in (configure, ["cmake", "--build", tmp_path, "--parallel", "2"]):
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    (kernel,) = tmp_path.glob("_kernel*.so")
    done = subprocess.run(
        [sys.executable, "-W", "ignore", Path(__file__).with_name("sanitized_kernel.py"), kernel],
        env=environment
        | {
            "LD_PRELOAD": f"{library('libasan.so')}:{library('libubsan.so')}",
            "ASAN_OPTIONS": "detect_leaks=0:symbolize=1:detect_odr_violation=0",
        },
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    assert done.stdout.strip() == "ran through"
