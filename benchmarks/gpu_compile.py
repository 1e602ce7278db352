"""What the GPU kernels become, without a GPU: registers, spills, and how wide memory is accessed.

The operators of `triton_launch.py` are called on tensors of a 1080p frame; what they would launch
is compiled for compute capability 8.0 and 9.0 instead, by Triton and the ptxas that comes with it.
Registers and spills are ptxas's; loads, stores and atomic additions of one thread are counted in
the PTX, by their bytes. Nothing here says how fast the kernels are.
Prints a table, and writes benchmarks/results/gpu_compile.json.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
import triton
from triton.backends.compiler import GPUTarget
from triton.backends.nvidia.compiler import get_ptxas
from triton.runtime.driver import driver

from raden_torch.brdf.model import triton_kernels, triton_launch

CAPABILITIES = (80, 90)
FRAME = (1, 3, 1080, 1920)
WARP = (0.4, 0.4)
_ACCESS = re.compile(
    r"^\s*(?:@%\S+ )?(?:(ld|st)\.global|(red|atom)\.\S*global)\S*?(?:\.v([24]))?\.[bfu](\d+)\b",
    re.M,
)


class _Target:
    """Stands for Triton's driver, where there is none: only the compiler asks it."""

    def __init__(self, capability: int) -> None:
        self.capability = capability

    def get_current_device(self) -> int:
        return self.capability

    def get_current_stream(self, device: int) -> int:
        return 0

    def get_current_target(self) -> GPUTarget:
        return GPUTarget("cuda", self.capability, 32)


class _Compiled:
    """In place of a kernel: compiles what would be launched, and keeps it."""

    def __init__(self, name: str, block: int, found: list[Any]) -> None:
        self.kernel, self.block, self.found = getattr(triton_kernels, name), block, found

    def __getitem__(self, grid: Any) -> Callable[..., None]:
        def compile_it(*arguments: Any, **options: Any) -> None:
            sizes = {"BLOCK": self.block, "num_warps": self.block // 32}
            self.found.append(self.kernel.warmup(*arguments, grid=(1,), **sizes, **options))

        return compile_it


def calls() -> dict[str, Callable[[], object]]:
    """By what they do, calls of the operators."""
    single = torch.zeros(FRAME)
    table, lamps = torch.zeros(32, 69, 67, 3), torch.zeros(8, 1, 13)
    camera, mask = torch.zeros(1, 3), torch.zeros(1, 1, *FRAME[2:])
    size = (FRAME[0], *FRAME[2:])

    def reflect(dtype: torch.dtype) -> Callable[[], object]:
        return lambda: triton_launch.brdf(*[single.to(dtype)] * 3, table, WARP)

    def shade(*maps: torch.Tensor | None) -> Callable[[], object]:
        return lambda: triton_launch.shade(size, maps, lamps, table, WARP)

    def backward(*wanted: bool) -> Callable[[], object]:
        return lambda: triton_launch.brdf_backward(single, [*[single] * 3, table], WARP, wanted)

    def in_any_order() -> object:
        torch.use_deterministic_algorithms(True)
        try:
            return backward(False, False, False, True)()
        finally:
            torch.use_deterministic_algorithms(False)

    return {
        "f_r, float32 maps": reflect(torch.float32),
        "f_r, float16 maps": reflect(torch.float16),
        "f_r, bfloat16 maps": reflect(torch.bfloat16),
        "shade, distant lamps": shade(single, None, single, None, None, None),
        "shade, any lamps, a mask": shade(single, None, None, single, camera, mask),
        "gradient of the vectors": backward(True, True, True, False),
        "gradient of the table": backward(False, False, False, True),
        "… deterministic": in_any_order,
        "gradient of both": backward(True, True, True, True),
    }


def compiled(call: Callable[[], object], capability: int, block: int) -> Any:
    """The kernel that a call would launch."""
    driver.set_active(_Target(capability))
    found: list[Any] = []
    for name in triton_launch.FLAGS:
        triton_launch.KERNELS[name] = _Compiled(name, block, found)
    call()
    return found[0]


def describe(binary: Any, capability: int) -> dict[str, Any]:
    """Registers, spilled bytes, bytes of shared memory, and memory accesses by width."""
    ptx = binary.asm["ptx"]
    accesses = Counter(
        f"{load or add} {int(bits) * int(vector or 1) // 8}"
        for load, add, vector, bits in _ACCESS.findall(ptx)
    )
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "kernel.ptx"
        source.write_text(ptx)
        gpu = f"--gpu-name=sm_{capability}{'a' if capability >= 90 else ''}"
        command = [
            get_ptxas(capability).path,
            "-v",
            gpu,
            source,
            "-o",
            source.with_suffix(".cubin"),
        ]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stderr

    def number(pattern: str) -> int:
        match = re.search(pattern, said)
        return int(match[1]) if match else 0

    return {
        "registers": number(r"Used (\d+) registers"),
        "spilled bytes": number(r"(\d+) bytes spill stores"),
        "shared bytes": binary.metadata.shared,
        "accesses": dict(sorted(accesses.items())),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--block", type=int, default=128, help="pixels of a program")
    block = parser.parse_args().block
    report: dict[str, Any] = {"triton": triton.__version__, "block": block}
    for what, call in calls().items():
        for capability in CAPABILITIES:
            row = describe(compiled(call, capability, block), capability)
            report[f"{what}, sm_{capability}"] = row
            accesses = ", ".join(f"{n} × {width}" for width, n in row["accesses"].items())
            print(
                f"{what:24s} sm_{capability}  {row['registers']:3d} registers, "
                f"{row['spilled bytes']} bytes spilled, {row['shared bytes']} shared; {accesses}"
            )
    out = Path(__file__).with_name("results") / "gpu_compile.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
