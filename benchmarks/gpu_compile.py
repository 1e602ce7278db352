"""What the GPU kernels become, without a GPU: registers, spills, and how wide memory is accessed.

Every kernel of `triton_kernels.py` is compiled ahead of time for compute capability 8.0 and 9.0, by
Triton and the ptxas that comes with it, as a contiguous frame calls it. Registers and spills are
ptxas's; the accesses of 32 pixels are counted in the PTX. Nothing here says how fast they are.
Prints a table, and writes benchmarks/results/gpu_compile.json.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import triton
from triton.backends.compiler import GPUTarget
from triton.backends.nvidia.compiler import get_ptxas
from triton.compiler import ASTSource

from raden_torch.brdf.model import triton_kernels, triton_launch

CAPABILITIES = (80, 90)
_KINDS = {"float32": "*fp32", "float16": "*fp16", "bfloat16": "*bf16"}
_ONE = object()
_Argument = Any


def _map(dtype: str = "float32") -> tuple[_Argument, ...]:
    return (_KINDS[dtype], "i32", "i32", "i32", _ONE)


_TABLE = ("*fp32", "i32", "i32", "i32", "fp32", "fp32")


def variants() -> dict[str, tuple[str, dict[str, _Argument], dict[str, bool]]]:
    """By what they do: the kernel, its arguments and its flags."""
    found = {}
    for dtype in _KINDS:
        maps = {name: _map(dtype) for name in ("normal", "light", "view")}
        found[f"f_r, {dtype} maps"] = ("reflect", maps | {"table": _TABLE, "image": _map()}, {})
    lamps = {
        "lamps": "*fp32",
        "lamp_count": "i32",
        "lamp_stride": "i32",
        "lamp_image_stride": "i32",
    }
    scene = {name: _map() for name in ("normal", "view", "position", "mask")}
    for what, near, masked in (("distant lamps", False, False), ("near lamps, mask", True, True)):
        flags = {"CAMERA": near, "POSITION": near, "MASK": masked}
        found[f"shade, {what}"] = (
            "shade",
            scene | lamps | {"table": _TABLE, "image": _map()},
            flags,
        )
    back = {name: _map() for name in ("gradient", "normal", "light", "view")}
    back |= {"table": _TABLE, **{f"to_{name}": _map() for name in ("normal", "light", "view")}}
    for what, vectors, table in (
        ("vectors", True, False),
        ("table", False, True),
        ("both", True, True),
    ):
        flags = {**dict.fromkeys(("NORMAL", "LIGHT", "VIEW"), vectors), "TABLE": table}
        found[f"gradient of {what}"] = ("differentiate", back | {"sums": "*fp32"}, flags)
    return found


def compiled(
    name: str, arguments: dict[str, _Argument], flags: dict[str, bool], capability: int, block: int
) -> Any:
    """One kernel as Triton compiles it: pointers aligned, the columns of maps one after another."""
    kernel = getattr(triton_kernels, name)
    constants: dict[tuple[int, ...], Any] = {}
    aligned: dict[tuple[int, ...], Any] = {}

    def kind(value: _Argument, path: tuple[int, ...]) -> Any:
        if isinstance(value, tuple):
            return tuple(kind(v, (*path, k)) for k, v in enumerate(value))
        if value is _ONE:
            constants[path] = 1
            return "constexpr"
        if value.startswith("*") or (value == "i32" and len(path) > 1 and path[1] < 4):
            aligned[path] = [["tt.divisibility", 16]]
        return value

    given = {**arguments, "count": "i32", "columns": "i32"}
    fixed = {**flags, "ONE_ROW": True, "WIDE": False, "BLOCK": block}
    signature = {}
    for place, argument in enumerate(kernel.arg_names):
        if argument in fixed:
            signature[argument] = "constexpr"
            constants[(place,)] = fixed[argument]
        else:
            signature[argument] = kind(given[argument], (place,))
    # nodes of the table are as they come
    table = kernel.arg_names.index("table")
    aligned = {p: a for p, a in aligned.items() if p[0] != table or p[1:] == (0,)}
    return triton.compile(
        ASTSource(kernel, signature, constants, aligned),
        target=GPUTarget("cuda", capability, 32),
        options={"num_warps": block // 32, **triton_launch.OPTIONS},
    )


def describe(binary: Any, capability: int) -> dict[str, Any]:
    """Registers, spilled bytes, bytes of shared memory, and memory accesses by width."""
    ptx = binary.asm["ptx"]
    widths = Counter()
    for what, vector, bits in re.findall(
        r"^\s*(?:@%\S+ )?(ld\.global|st\.global|(?:red|atom)\.\S*?global)\S*?(\.v[24])?\.[bfu](\d+)\b",
        ptx,
        re.M,
    ):
        widths[f"{what.split('.')[0]} {int(bits) * int((vector or '.v1')[2:]) // 8}"] += 1
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "kernel.ptx"
        source.write_text(ptx)
        said = subprocess.run(
            [
                get_ptxas(capability).path,
                "-v",
                f"--gpu-name=sm_{capability}{'a' if capability >= 90 else ''}",
                source,
                "-o",
                source.with_suffix(".cubin"),
            ],
            capture_output=True,
            text=True,
            check=True,
        ).stderr

    def number(pattern: str) -> int:
        match = re.search(pattern, said)
        return int(match[1]) if match else 0

    return {
        "registers": number(r"Used (\d+) registers"),
        "spilled bytes": number(r"(\d+) bytes spill stores"),
        "shared bytes": binary.metadata.shared,
        "accesses": dict(sorted(widths.items())),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--block", type=int, default=128, help="pixels of a program")
    block = parser.parse_args().block
    report: dict[str, Any] = {"triton": triton.__version__, "block": block}
    for what, (name, arguments, flags) in variants().items():
        for capability in CAPABILITIES:
            row = describe(compiled(name, arguments, flags, capability, block), capability)
            report[f"{what}, sm_{capability}"] = row
            accesses = ", ".join(f"{n} × {width} bytes" for width, n in row["accesses"].items())
            print(
                f"{what:24s} sm_{capability}  {row['registers']:3d} registers, "
                f"{row['spilled bytes']} bytes spilled, {row['shared bytes']} shared; {accesses}"
            )
    out = Path(__file__).with_name("results") / "gpu_compile.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
