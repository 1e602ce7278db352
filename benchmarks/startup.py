"""What `import raden_torch` adds to `import torch`, as a ratio within one run.

Each import runs in a process of its own, in turn, so that a drift of the machine hits both alike.
The second row imports everything that shading needs, as a program that shades does anyway.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

RUNS = 9
STATEMENTS = {
    "import torch": "import torch",
    "import torch; import raden_torch": "import torch, raden_torch",
    "import raden_torch and its shading": "import raden_torch as rt; rt.shade, rt.load_model",
}


def seconds(statement: str) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", statement], check=True)
    return time.perf_counter() - start


def main() -> None:
    for statement in STATEMENTS.values():  # warm the file cache
        seconds(statement)
    times = {name: [] for name in STATEMENTS}
    for _ in range(RUNS):
        for name, statement in STATEMENTS.items():
            times[name].append(seconds(statement))
    base = times["import torch"]
    rows = [
        {
            "what": name,
            "ratio_median": statistics.median(x / b for x, b in zip(taken, base, strict=True)),
            "ratio_worst": max(x / b for x, b in zip(taken, base, strict=True)),
            "seconds_median": statistics.median(taken),
        }
        for name, taken in times.items()
    ]
    out = Path(__file__).with_name("results") / "startup.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps({"runs": RUNS, "rows": rows}, indent=2) + "\n")
    for row in rows:
        print(f"{row['ratio_median']:.2f} x import torch  {row['what']}")


if __name__ == "__main__":
    main()
