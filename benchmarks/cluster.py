"""What a cluster adds to a frame of 1080p, and what two workers bring, as ratios within one run.

Real processes on loopback: a scheduler, and workers of one thread, with one OpenMP thread. The same
frames are lit by turns in this process, by one worker and by two, from the first outcome to the
last, so that starting does not count. Processor time is of all processes together; others on the
machine change it little. The gap is the time that a worker is not in a frame.
Then tasks of nothing, for what a task costs the scheduler. Run with OMP_NUM_THREADS=1.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import psutil
import torch

import raden_torch as rt

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/sequences"))

from cluster_jobs import Stamped
from cluster_processes import Cluster

from raden_torch.images.exr import write_channels
from raden_torch.sequences.cluster import DaskEngine
from raden_torch.sequences.job import Engine
from raden_torch.sequences.local import LocalEngine
from raden_torch.sequences.render_job import RenderJob, plan_render

FRAMES, RUNS, SIZE, TASKS = 8, 3, (1080, 1920), 500


def write_frames(folder: Path) -> None:
    """Simulated normals, a ball that moves, as a renderer writes them."""
    height, width = SIZE
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    for number in range(1, FRAMES + 1):
        u, v = (x - 400 - 40 * number) / 400, (540 - y) / 400
        inside = 1 - u**2 - v**2
        normal = torch.stack([u, v, inside.clamp_min(0).sqrt()]) * (inside > 0)
        channels = dict(zip("RGB", normal.to(torch.float16).numpy(), strict=True))
        write_channels(folder / f"shot.{number:04d}.exr", channels)


def processor_s(cluster: Cluster | None) -> float:
    """Of this process and the cluster's."""
    if cluster is None:
        return time.process_time()
    there = [p.pid for p in (cluster.scheduler, *cluster.workers) if p.poll() is None]
    return time.process_time() + sum(sum(psutil.Process(p).cpu_times()[:2]) for p in there)


def timed(engine: Engine, job: RenderJob, cluster: Cluster | None, frames: Sequence[int]) -> dict:
    """Seconds a frame, from the first outcome to the last."""
    begun, stamps = time.perf_counter(), []
    for outcome in engine.run(job, frames):
        assert outcome.state == "written", outcome
        stamps.append((time.perf_counter(), processor_s(cluster), sum(outcome.seconds.values())))
    (first, cpu, _), (last, cpu_after, _), count = stamps[0], stamps[-1], len(stamps) - 1
    stages = sum(each for _, _, each in stamps[1:])
    return {
        "wall_s": (last - first) / count,
        "processor_s": (cpu_after - cpu) / count,
        "in_stages_s": stages / count,
        "to_first_outcome_s": first - begun,
    }


def idle_share(cluster: Cluster) -> float:
    """Processor time a second of a scheduler and workers that have nothing to do."""
    before, start = processor_s(cluster), time.perf_counter()
    time.sleep(5)
    return (processor_s(cluster) - before) / (time.perf_counter() - start)


def tasks(cluster: Cluster, folder: Path) -> dict:
    """Of `TASKS` tasks that write a few bytes."""
    (folder / "stamp").write_bytes(b"x")
    (folder / "tasks").mkdir()
    scheduler = psutil.Process(cluster.scheduler.pid)
    busy, start = sum(scheduler.cpu_times()[:2]), None
    for outcome in DaskEngine(cluster.address).run(
        Stamped(folder / "tasks", folder / "stamp"), range(TASKS)
    ):
        start = start or time.perf_counter()
        assert outcome.state == "written", outcome
    return {
        "scheduler_processor_ms": 1e3 * (sum(scheduler.cpu_times()[:2]) - busy) / TASKS,
        "wall_ms": 1e3 * (time.perf_counter() - start) / TASKS,
    }


def median(rows: Sequence[dict]) -> dict:
    return {key: statistics.median(row[key] for row in rows) for key in rows[0]}


def main() -> None:
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_frames(folder)
        shell = folder / "shell.safetensors"
        rt.save_model(rt.fit(rt.simulate_specimen("yakogai")).model, shell)
        (folder / "lit").mkdir()
        asked = RenderJob(
            target=folder / "lit/lit.####.exr",
            force=True,
            model=shell,
            gbuffer=folder / "shot.####.exr",
        )
        job, frames = plan_render(asked, range(1, FRAMES + 1))
        clusters = {}
        for count in (1, 2):
            (folder / f"cluster{count}").mkdir()
            here = (Path(__file__).parents[1] / "tests/sequences",)
            clusters[count] = Cluster(folder / f"cluster{count}", here)
            for _ in range(count):
                clusters[count].add_worker()
        try:
            engines = {
                "this process": (LocalEngine(readers=1, writers=1), None),
                "1 worker": (DaskEngine(clusters[1].address), clusters[1]),
                "2 workers": (DaskEngine(clusters[2].address), clusters[2]),
            }
            rows: dict[str, list[dict]] = {name: [] for name in engines}
            pictures = {}
            for run in range(RUNS + 1):
                for name, (engine, cluster) in engines.items():
                    row = timed(engine, job, cluster, frames)
                    pictures[name] = [job.output(n).read_bytes() for n in frames]
                    if run:
                        rows[name].append(row)
                        print(name, json.dumps(row), flush=True)
            idle = {count: idle_share(cluster) for count, cluster in clusters.items()}
            small = tasks(clusters[1], folder)
        finally:
            for cluster in clusters.values():
                cluster.close()
    medians = {name: median(each) for name, each in rows.items()}
    alone, one, two = (medians[name] for name in engines)
    result = {
        "frames": FRAMES,
        "runs": RUNS,
        "size": SIZE,
        "cores": os.cpu_count(),
        "medians": medians,
        "same_bytes": all(each == pictures["this process"] for each in pictures.values()),
        "idle_processor_share": idle,
        "processor_time_of_1_worker_over_alone": one["processor_s"] / alone["processor_s"],
        "the_same_less_what_idles": (one["processor_s"] - idle[1] * one["wall_s"])
        / alone["processor_s"],
        "gap_over_frame": (one["wall_s"] - one["in_stages_s"]) / one["in_stages_s"],
        "rate_of_2_workers_over_1": one["wall_s"] / two["wall_s"],
        "processor_time_of_2_workers_over_1": two["processor_s"] / one["processor_s"],
        "tasks_of_nothing": {"count": TASKS, **small},
    }
    out = Path(__file__).with_name("results") / "cluster.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(result, indent=2) + "\n")
    print(json.dumps({k: v for k, v in result.items() if k != "medians"}, indent=2))


if __name__ == "__main__":
    main()
