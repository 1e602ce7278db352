"""What `import raden_torch` adds to `import torch`, as a ratio within one run.

Each import runs in a process of its own, in turn, so that a drift of the machine hits both alike.
The second row imports everything that shading needs, as a program that shades does anyway. Then, in
new processes too: from `load_model` to the first frame (1080p) after the import.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RUNS = 9
STATEMENTS = {
    "import torch": "import torch",
    "import torch; import raden_torch": "import torch, raden_torch",
    "import raden_torch and its shading": "import raden_torch as rt; rt.shade, rt.load_model",
}
FIRST_FRAME = """
import sys, time
import torch, raden_torch as rt
rt.load_model, rt.shade
normal = torch.nn.functional.normalize(torch.rand(1, 3, 1080, 1920), dim=1)
start = time.perf_counter()
model = rt.load_model(sys.argv[1])
scene = rt.GBuffer(normal, (0.0, 0.0, 1.0))
with torch.no_grad():
    rt.shade(model, scene, rt.DirectionalLight((1.0, 1.0, 2.0)))
print(time.perf_counter() - start)
"""


def first_frame() -> list[float]:
    """Seconds from `load_model` to an image, of the simulated shell that `fit` models."""
    import raden_torch as rt

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shell.safetensors"
        rt.save_model(rt.fit(rt.simulate_specimen("yakogai")).model, path)
        command = [sys.executable, "-c", FIRST_FRAME, str(path)]
        done = [subprocess.run(command, check=True, capture_output=True) for _ in range(RUNS)]
    return [float(run.stdout) for run in done]


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
    frames = first_frame()
    first = {"seconds_median": statistics.median(frames), "seconds_worst": max(frames)}
    report = {"runs": RUNS, "rows": rows, "load_model to the first frame": first}
    out.write_text(json.dumps(report, indent=2) + "\n")
    for row in rows:
        print(f"{row['ratio_median']:.2f} x import torch  {row['what']}")
    print(
        f"load_model to the first 1080p frame: {first['seconds_median']:.3f} s, "
        f"worst {first['seconds_worst']:.3f} s"
    )


if __name__ == "__main__":
    main()
