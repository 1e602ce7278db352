"""A sequence of EXR G-buffers lit into EXRs: each stage alone against the whole.

The frames are simulated (a rippled sphere with noise, half floats with ZIP, and 32-bit floats
uncompressed), on the disk of `--folder`. In turn, several rounds, milliseconds a frame:

  read, work, write   the engine with that stage alone; `work` holds its frames in memory
  disk                reading and writing overlapped, nothing shaded
  whole               what `raden render --frames` does
  in turn             the three stages of each frame one after the other, on one thread

`engine alone` is the engine with stages that wait and use no processor.

`share_of_slowest` is the slowest of read, work and write over the whole, `share_of_disk` is disk
over the whole. `cpu_over_stages` is the whole's processor time over that of the three stages alone:
what the overlap costs. `busy` is this program's processor time over wall-clock time and processors,
`stolen` that of other programs: where both add up to 1, no order of the stages can be faster.
Results go to benchmarks/results/sequences.json; nothing is asserted.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.model import simd
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.images.exr import write_channels
from raden_torch.images.openimageio import openimageio
from raden_torch.sequences.job import Job, done_alone
from raden_torch.sequences.lighting import Lighting
from raden_torch.sequences.local import LocalEngine
from raden_torch.sequences.render_job import Lit, RenderJob, plan_render

KINDS = {"half, zip": (True, "zip"), "float, uncompressed": (False, "none")}
LAMP = rt.DirectionalLight((1.0, 1.0, 2.0))


@dataclass(frozen=True, kw_only=True)
class ReadAlone(RenderJob):
    def work(self, prepared: Lit, read: GBuffer) -> Any:
        return None

    def write(self, prepared: Lit, worked: Any, item: int) -> bool:
        return True


@dataclass(frozen=True, kw_only=True)
class WorkAlone(RenderJob):
    held: Any = None

    def read(self, prepared: Lit, item: int) -> GBuffer:
        return self.held[item % len(self.held)]

    def write(self, prepared: Lit, worked: Tensor, item: int) -> bool:
        return True


@dataclass(frozen=True, kw_only=True)
class WriteAlone(RenderJob):
    held: Any = None

    def read(self, prepared: Lit, item: int) -> Any:
        return None

    def work(self, prepared: Lit, read: Any) -> Tensor:
        return self.held


@dataclass(frozen=True, kw_only=True)
class Disk(RenderJob):
    held: Any = None

    def work(self, prepared: Lit, read: GBuffer) -> Tensor:
        return self.held


def frame(number: int, height: int, width: int) -> Tensor:
    """`[3, H, W]` simulated normals."""
    y, x = torch.meshgrid(
        torch.linspace(-1, 1, height), torch.linspace(-width / height, width / height, width),
        indexing="ij",
    )  # fmt: skip
    inside = (x * x + y * y < 0.9).float()
    ripple = 0.1 * torch.sin(30 * x + 0.3 * number) * torch.cos(25 * y)
    n = torch.stack(
        [x * inside + ripple, y * inside + ripple, (1 - inside * (x * x + y * y)).sqrt()]
    )
    noise = torch.randn(n.shape, generator=torch.Generator().manual_seed(number))
    return torch.nn.functional.normalize(n + 0.01 * noise, dim=0)


def write_frames(folder: Path, count: int, size: tuple[int, int], half: bool, how: str) -> None:
    oiio = openimageio()
    for number in range(1, count + 1):
        path = folder / f"shot.{number:04d}.exr"
        channels = dict(zip(("N.X", "N.Y", "N.Z"), frame(number, *size).numpy(), strict=True))
        if how == "zip":
            write_channels(path, channels, half=half)
            continue
        pixels = np.stack(list(channels.values()), axis=-1)
        spec = oiio.ImageSpec(size[1], size[0], 3, oiio.HALF if half else oiio.FLOAT)
        spec.channelnames = tuple(channels)
        spec.attribute("compression", how)
        file = oiio.ImageOutput.create("openexr")
        done = file.open(str(path), spec) and file.write_image(pixels) and file.close()
        assert done, file.geterror()


@dataclass(frozen=True)
class Waiting(Job[int, None, None, None]):
    """Stages that wait, as a network disk or a GPU lets a processor wait: no processor is used."""

    seconds: tuple[float, float, float] = (0.1, 0.05, 0.08)

    @property
    def shared(self) -> tuple[Path, ...]:
        return ()

    def relocated(self, places: Mapping[Path, Path]) -> Waiting:
        return self

    def inputs(self, item: int) -> tuple[Path, ...]:
        return ()

    def output(self, item: int) -> Path:
        return Path(str(item))

    def prepare(self) -> None:
        return None

    def is_done(self, item: int) -> bool:
        return False

    def read(self, prepared: None, item: int) -> None:
        time.sleep(self.seconds[0])

    def work(self, prepared: None, read: None) -> None:
        time.sleep(self.seconds[1])

    def write(self, prepared: None, worked: None, item: int) -> bool:
        time.sleep(self.seconds[2])
        return True


def engine_alone(count: int = 50) -> dict[str, float]:
    """One thread a stage, stages that wait: the slowest of them over the whole."""
    job = Waiting()
    engine = LocalEngine(readers=1, writers=1, prepared=())
    ms = timed(lambda: list(engine.run(job, range(count))), count)["ms"]
    # the first item passes through all stages before any overlap
    first = 1e3 * (sum(job.seconds) - max(job.seconds)) / count
    return {"ms": round(ms, 2), "share_of_slowest": round(1e3 * max(job.seconds) / (ms - first), 3)}


def others(kind: type[RenderJob], job: RenderJob, **more: Any) -> RenderJob:
    return kind(**{f.name: getattr(job, f.name) for f in fields(RenderJob)}, **more)


def stolen() -> float:
    """Seconds that all processors spent on anything, this program included."""
    user, nice, system = (int(n) for n in Path("/proc/stat").read_text().split()[1:4])
    return (user + nice + system) / os.sysconf("SC_CLK_TCK")


def timed(run: Callable[[], object], count: int) -> dict[str, float]:
    cores = len(os.sched_getaffinity(0))
    wall, own, all_of_them = time.perf_counter(), time.process_time(), stolen()
    run()
    wall, own = time.perf_counter() - wall, time.process_time() - own
    others_took = max(0.0, stolen() - all_of_them - own) / (wall * cores)
    busy = own / (wall * cores)
    return {
        "ms": 1e3 * wall / count,
        "cpu_ms": 1e3 * own / count,
        "busy": busy,
        "stolen": others_took,
    }


def measured(
    kind: str, size: tuple[int, int], count: int, rounds: int, folder: Path
) -> dict[str, Any]:
    half, how = KINDS[kind]
    write_frames(folder, count, size, half, how)
    model = folder / "shell.safetensors"
    rt.save_model(rt.fit(rt.simulate_specimen("yakogai")).model, model)
    frames = range(1, count + 1)
    job, left = plan_render(
        RenderJob(
            target=folder / "lit.####.exr",
            force=True,
            model=model,
            gbuffer=folder / "shot.####.exr",
            lighting=Lighting((LAMP,)),
        ),
        frames,
    )
    prepared = job.prepare()
    held = [job.read(prepared, n) for n in frames[:4]]
    image = job.work(prepared, held[1])
    engine = LocalEngine(prepared=prepared)

    def all_of(what: RenderJob) -> Callable[[], object]:
        def run() -> None:
            states = {outcome.state for outcome in engine.run(what, left)}
            assert states == {"written"}, states

        return run

    def in_turn() -> None:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        for number in left:
            assert done_alone(job, prepared, number).state == "written"
        torch.set_num_threads(threads)

    stages = {
        "read": all_of(others(ReadAlone, job)),
        "work": all_of(others(WorkAlone, job, held=held)),
        "write": all_of(others(WriteAlone, job, held=image)),
        "disk": all_of(others(Disk, job, held=image)),
        "whole": all_of(job),
        "in turn": in_turn,
    }
    runs: dict[str, list[dict[str, float]]] = {name: [] for name in stages}
    for turn in range(rounds + 1):
        for name, stage in stages.items():
            taken = timed(stage, count)
            if turn:
                runs[name].append(taken)
    found = {
        name: {key: round(statistics.median(run[key] for run in each), 3) for key in each[0]}
        for name, each in runs.items()
    }
    whole = found["whole"]["ms"]
    in_order = (runs[name] for name in ("read", "work", "write", "disk", "whole"))
    by_round = [[run["ms"] for run in each] for each in zip(*in_order, strict=True)]
    alone = sum(found[name]["cpu_ms"] for name in ("read", "work", "write"))
    return {
        "frames": found,
        "share_of_slowest": round(statistics.median(max(ms[:3]) / ms[4] for ms in by_round), 3),
        "share_of_disk": round(statistics.median(ms[3] / ms[4] for ms in by_round), 3),
        "cpu_over_stages": round(found["whole"]["cpu_ms"] / alone, 3),
        "speed_up": round(found["in turn"]["ms"] / whole, 2),
        "megabytes_read": round((folder / "shot.0002.exr").stat().st_size / 1e6, 2),
        "megabytes_written": round((folder / "lit.0002.exr").stat().st_size / 1e6, 2),
        **engine.room(job),
    }


_PEAK = """
import sys
from pathlib import Path
from raden_torch.sequences.lighting import Lighting
from raden_torch.sequences.local import LocalEngine
from raden_torch.sequences.render_job import RenderJob, plan_render
import raden_torch as rt
folder, count = Path(sys.argv[1]), int(sys.argv[2])
job, left = plan_render(
    RenderJob(
        target=folder / "peak.####.exr", force=True, model=folder / "shell.safetensors",
        gbuffer=folder / "shot.####.exr",
        lighting=Lighting((rt.DirectionalLight((1.0, 1.0, 2.0)),)),
    ),
    range(1, count + 1),
)
def peak():
    line = next(s for s in open("/proc/self/status") if s.startswith("VmHWM"))
    return 1024 * int(line.split()[1])
engine = LocalEngine(prepared=job.prepare())
import raden_torch.brdf.model.shading_kernel
before = peak()
assert {o.state for o in engine.run(job, left)} == {"written"}
print(before, peak())
"""


def peak_memory(folder: Path, count: int) -> dict[str, int]:
    """Bytes beside what the program takes, in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", _PEAK, str(folder), str(count)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    before, after = map(int, done.stdout.split())
    return {"program_bytes": before, "peak_bytes_beside": after - before}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--size", type=int, nargs=2, default=(1080, 1920), metavar="PIXELS")
    parser.add_argument("--folder", type=Path, help="where the frames go; a temporary folder")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/sequences.json"))
    asked = parser.parse_args()
    size = (asked.size[0], asked.size[1])
    results: dict[str, Any] = {
        "machine": f"{platform.machine()}, {len(os.sched_getaffinity(0))} processors",
        "kernel": simd.level(),
        "size": size,
        "engine_alone": engine_alone(),
        "kinds": {},
    }
    print("engine alone", results["engine_alone"])
    for kind in KINDS:
        with tempfile.TemporaryDirectory(dir=asked.folder) as folder:
            found = measured(kind, size, asked.frames, asked.rounds, Path(folder))
            found |= peak_memory(Path(folder), asked.frames)
        results["kinds"][kind] = found
        print(kind)
        for name, value in found["frames"].items():
            print(f"  {name:8}", ", ".join(f"{k} {v}" for k, v in value.items()))
        print("  ", {k: v for k, v in found.items() if k != "frames"})
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    asked.out.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
