"""Many machines: a real cluster of processes on loopback, killed workers and schedulers.

The module's cluster starts once; its tests run in order, each with the workers that it needs.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch
import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.images.exr import write_channels

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # as the workers import them

from cluster_jobs import Stamped  # noqa: E402
from cluster_processes import Cluster  # noqa: E402

from raden_torch.errors import InputError  # noqa: E402
from raden_torch.sequences import cluster_worker  # noqa: E402
from raden_torch.sequences.cluster import DaskEngine  # noqa: E402
from raden_torch.sequences.cluster_client import connected  # noqa: E402
from raden_torch.sequences.cluster_worker import (  # noqa: E402
    Order,
    SharedFile,
    Station,
    absolute,
    on_device,
)
from raden_torch.sequences.local import LocalEngine  # noqa: E402
from raden_torch.sequences.machine import Machine, this_machine  # noqa: E402
from raden_torch.sequences.render_job import RenderJob  # noqa: E402

pytestmark = pytest.mark.slow
STAMP = b"a model's bytes"
NOT_THE_INSTALLED_ONE = """
import sys
sys.meta_path[:] = [f for f in sys.meta_path if "raden_torch" not in type(f).__module__]
"""


def wait_for_workers(cluster: Cluster, count: int) -> None:
    with connected(cluster.address, 60) as client:
        client.wait_for_workers(count, timeout=60)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    made = Cluster(tmp_path_factory.mktemp("cluster"), (HERE,))
    made.add_worker(threads=2)
    made.add_worker(threads=2)
    wait_for_workers(made, 2)
    yield made
    made.close()


@pytest.fixture
def job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Stamped:
    """With relative paths, which other machines have to find all the same."""
    monkeypatch.chdir(tmp_path)
    Path("stamp.bin").write_bytes(STAMP)
    Path("out").mkdir()
    return Stamped(Path("out"), Path("stamp.bin"))


@pytest.fixture
def said() -> list[str]:
    return []


def files(folder: Path) -> dict[str, bytes]:
    """All that is there, hidden files too."""
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "done.log"}


def expected(count: int) -> dict[str, bytes]:
    return {f"{n:03d}.bin": STAMP + bytes([n]) for n in range(count)}


def meanwhile(ready: Callable[[], bool], act: Callable[[], object]) -> threading.Thread:
    """A thread that acts once."""

    def wait() -> None:
        while not ready():
            time.sleep(0.02)
        act()

    thread = threading.Thread(target=wait)
    thread.start()
    return thread


def test_files_are_those_of_one_machine_and_one_that_fails_is_told(
    cluster: Cluster, job: Stamped, tmp_path: Path
) -> None:
    there = replace(job, broken=3)
    engine = DaskEngine(cluster.address)
    done = {outcome.item: outcome for outcome in engine.run(there, range(12))}
    (tmp_path / "here").mkdir()
    here = replace(job, folder=tmp_path / "here", broken=3)
    assert {o.item: o.state for o in LocalEngine().run(here, range(12))} == {
        item: outcome.state for item, outcome in done.items()
    }
    assert files(job.folder) == files(here.folder)
    assert done[3].state == "failed"
    assert done[3].message == f"{Path('stamp.bin').absolute()}: item 3 is broken"
    processes = {line.split()[1] for line in (job.folder / "done.log").read_text().splitlines()}
    assert processes == {str(worker.pid) for worker in cluster.workers}
    assert {o.state for o in engine.run(job, [0, 1])} == {"kept"}


def test_frames_and_sweeps_from_the_command_line(
    cluster: Cluster, tmp_path: Path, raden: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    matt = rt.RadenBrdf(CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.ones(3)), None)
    rt.save_model(matt, tmp_path / "matt.safetensors")
    for number in (1, 2, 3):
        normal = np.random.default_rng(number).normal(size=(3, 9, 16))
        normal[2] += 4
        normal = (normal / np.linalg.norm(normal, axis=0)).astype(np.float16)
        channels = dict(zip("RGB", normal, strict=True))
        write_channels(tmp_path / f"shot.{number:04d}.exr", channels)
    (tmp_path / "t.csv").write_text('name,light\na.png,"1,1,2"\nb.png,\n')
    render = ("render", "matt.safetensors", "--gbuffer", "shot.####.exr", "--frames", "1-3")
    sweep = ("--", "render", "matt.safetensors", "--size", "16")
    there = ("--engine", "dask", "--scheduler", cluster.address)
    for place, engine in (("here", ()), ("there", there)):
        (tmp_path / place).mkdir()
        frames = raden(*render, "-o", f"{place}/lit.####.exr", *engine, cwd=tmp_path)
        swept = raden("sweep", "t.csv", "-o", place, *engine, *sweep, cwd=tmp_path)
        assert (frames.returncode, swept.returncode) == (0, 0), frames.stderr + swept.stderr
        assert ("3 written" in frames.stdout, "2 written" in swept.stdout) == (True, True)
        assert frames.stderr == ("raden: workers: 2, threads: 4\n" if engine else "")
    assert files(tmp_path / "here") == files(tmp_path / "there")
    assert len(files(tmp_path / "here")) == 5


def test_workers_of_another_source_or_instruction_set_are_left_out(
    cluster: Cluster, job: Stamped, said: list[str], tmp_path: Path
) -> None:
    """Rationale: their files would not be those of one machine; a stale checkout is as likely as
    an old processor, and has the same version number."""
    shutil.copytree(Path(raden_torch.__file__).parent, tmp_path / "old" / "raden_torch")
    with (tmp_path / "old/raden_torch/errors.py").open("a") as file:
        file.write("# an older checkout\n")
    (tmp_path / "old/sitecustomize.py").write_text(NOT_THE_INSTALLED_ONE)
    stale = cluster.add_worker(PYTHONPATH=f"{tmp_path / 'old'}{os.pathsep}{HERE}")
    other = cluster.add_worker(RADEN_TORCH_SIMD="portable")
    wait_for_workers(cluster, 4)
    try:
        for mixed, used in ((False, 2), (True, 3)):
            engine = DaskEngine(cluster.address, mixed=mixed, say=said.append)
            assert {o.state for o in engine.run(replace(job, seconds=0.05), range(4))}
            assert said[0].startswith(f"workers: {used}, ")
            left_out = " ".join(line for line in said if line.startswith("left out"))
            assert "raden_torch 0.1.0+" in left_out
            assert ("another instruction set" in left_out) is not mixed
            said.clear()
    finally:
        for worker in (stale, other):
            worker.kill()
            worker.wait()


def test_a_killed_workers_items_are_done_again_and_none_twice(
    cluster: Cluster, job: Stamped, said: list[str]
) -> None:
    engine = DaskEngine(cluster.address, say=said.append)
    killer = meanwhile(
        lambda: len(files(job.folder)) > 6, lambda: cluster.workers[1].send_signal(signal.SIGKILL)
    )
    outcomes = list(engine.run(replace(job, seconds=0.15), range(24)))
    killer.join()
    assert sorted(outcome.item for outcome in outcomes) == list(range(24))
    assert {outcome.state for outcome in outcomes} == {"written"}
    assert files(job.folder) == expected(24)  # nothing of the killed one is left
    assert sum("the worker was lost" in line for line in said) == 1
    assert "Remove worker" in cluster.log("scheduler")


def test_a_scheduler_that_comes_back_gets_what_is_left(
    cluster: Cluster, job: Stamped, said: list[str]
) -> None:
    def restart() -> None:
        cluster.scheduler.kill()
        cluster.scheduler.wait()
        cluster.start_scheduler()
        cluster.add_worker(threads=2)  # Dask's own end with their scheduler

    restarter = meanwhile(lambda: len(files(job.folder)) > 4, restart)
    engine = DaskEngine(cluster.address, say=said.append)
    outcomes = list(engine.run(replace(job, seconds=0.15), range(16)))
    restarter.join()
    assert sorted(outcome.item for outcome in outcomes) == list(range(16))
    assert files(job.folder) == expected(16)
    text = "\n".join(said)
    assert "the scheduler went away" in text
    assert "the scheduler is back" in text


def test_a_scheduler_that_stays_away_is_one_error_and_a_second_run_goes_on(
    cluster: Cluster, job: Stamped
) -> None:
    ending = meanwhile(lambda: len(files(job.folder)) > 3, cluster.scheduler.kill)
    engine = DaskEngine(cluster.address, wait_s=1)
    with pytest.raises(InputError, match=r"expected the scheduler back within 1 s, got none"):
        list(engine.run(replace(job, seconds=0.15), range(12)))
    ending.join()
    cluster.scheduler.wait()
    written = files(job.folder)
    cluster.start_scheduler()
    with pytest.raises(InputError, match=r"expected a worker within 1 s, got none; start"):
        list(engine.run(job, range(12)))  # the workers are gone
    cluster.add_worker()
    wait_for_workers(cluster, 1)
    outcomes = {outcome.item: outcome.state for outcome in engine.run(job, range(12))}
    assert len(outcomes) == 12
    assert files(job.folder) == expected(12)
    whole = {name for name in written if not name.startswith(".")}
    assert {n for n, state in outcomes.items() if state == "kept"} >= {int(n[:3]) for n in whole}


@pytest.mark.parametrize(
    ("address", "wanted"),
    [
        ("tcp://127.0.0.1:9", "tcp://127.0.0.1:9: expected a Dask scheduler, got no answer"),
        ("nowhere://x", "scheduler: expected an address as tcp://host:8786, got nowhere://x"),
        ("127.0.0.1", "scheduler: expected an address as tcp://host:8786, got 127.0.0.1"),
    ],
)
def test_no_scheduler_is_one_error(job: Stamped, address: str, wanted: str) -> None:
    with pytest.raises(InputError, match=f"^{wanted}"):
        list(DaskEngine(address).run(job, [0]))
    assert files(job.folder) == {}


def test_a_worker_says_what_it_does_not_see(
    job: Stamped, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_worker, "_SEEN_WITHIN_S", 0.1)
    order = Order(absolute(job), (), (str(tmp_path / "not here"),), this_machine(), False)
    with pytest.raises(InputError, match=r"^does not see .*not here$"):
        Station(order, tmp_path / "station")


def test_a_gpu_shades_what_can_be_shaded(job: Stamped) -> None:
    render = RenderJob(target=Path("a"), model=Path("b"), gbuffer=Path("c"))
    there = on_device(render, "cuda")
    assert isinstance(there, RenderJob)
    assert (there.device, replace(there, device="cpu")) == ("cuda", render)
    assert on_device(job, "cuda") is job


def test_a_shared_file_is_checked_by_its_hash(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(STAMP)
    file = SharedFile.read(tmp_path / "a.bin")
    assert file.put(tmp_path / "copies").read_bytes() == STAMP
    with pytest.raises(InputError, match=r"a\.bin: expected the SHA-256 [0-9a-f]{64}, got another"):
        replace(file, content=STAMP[1:]).put(tmp_path / "copies")


def test_what_is_different_is_named() -> None:
    here = Machine("3.11", "0.1.0+0", "2.13.0", "2.4.6", "1.17.1", "a")
    assert not here.difference(here)
    assert replace(here, torch="2.12.0").difference(here) == "torch 2.12.0 (here 2.13.0)"
    assert "instruction set" in replace(here, answer="b").difference(here)
    assert not replace(here, answer="b").difference(here, answers=False)
