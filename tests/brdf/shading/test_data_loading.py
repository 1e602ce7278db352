"""Scenes rendered by the workers of a torch DataLoader, however they start; pinned memory."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch import Tensor

import raden_torch as rt

SCRIPT = """
import os, sys, threading
import torch
from torch.utils.data import DataLoader, Dataset
import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable

LAMP = rt.DirectionalLight((0.3, 0.2, 1.0))

class Rendered(Dataset):
    "One image of 300 x 300 for each seed, and its scene."
    def __init__(self, model):
        self.model = model
    def __len__(self):
        return 4
    def __getitem__(self, k):
        normal = torch.randn(1, 3, 300, 300, generator=torch.Generator().manual_seed(k))
        normal[:, 2] = normal[:, 2].abs() + 0.2
        scene = rt.GBuffer(normal, view=(0.0, 0.0, 1.0))
        with torch.no_grad():
            return scene, rt.shade(self.model, scene, LAMP), os.getpid()

if __name__ == "__main__":
    torch.set_num_threads(2)
    table = ReflectanceTable(torch.rand(3, 3, 3, 3), (0.0, -70.0, -70.0), (35.0, 70.0, 70.0))
    model = rt.RadenBrdf(CosineDiffuse(torch.ones(3), torch.ones(3)), table)
    data = Rendered(model)
    expected = [data[k] for k in range(4)]        # starts torch's threads, and the kernel's own
    torch.rand(2_000_000).exp().sum()
    stop = threading.Event()
    def busy():                                    # the kernel is at work while the workers fork
        with torch.no_grad():
            while not stop.is_set():
                rt.shade(model, expected[0][0], LAMP)
    thread = threading.Thread(target=busy)
    thread.start()
    loader = DataLoader(data, batch_size=None, num_workers=2, multiprocessing_context=sys.argv[1])
    found = list(loader)
    stop.set()
    thread.join()
    for (scene, image, process), (scene_0, image_0, _) in zip(found, expected, strict=True):
        assert process != os.getpid()
        assert torch.equal(scene.normal, scene_0.normal) and torch.equal(image, image_0)
    assert float(image.max()) > 0
    print(len({process for _, _, process in found}), "workers")
"""


@pytest.mark.parametrize("start", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_workers_render_the_same_bits(start: str, tmp_path: Path) -> None:
    """Rationale: a forked child has none of its parent's threads, and a pool that does not know
    waits for them for ever."""
    if start == "fork" and not hasattr(os, "fork"):
        pytest.skip("fork is POSIX's")
    script = tmp_path / "loading.py"
    script.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "-W", "ignore", script, start],
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert (done.returncode, done.stdout) == (0, "2 workers\n"), done.stderr[-2000:]


def scene(**more: object) -> rt.GBuffer:
    normal = torch.rand(1, 3, 4, 5)
    mask, camera = torch.ones(1, 1, 4, 5), torch.tensor([0.0, 0.0, 3.0])
    return rt.GBuffer(normal, position=normal, camera=camera, mask=mask)


def test_a_gbuffer_moves_with_all_of_its_maps() -> None:
    moved = scene().to("meta", non_blocking=True)
    tensors = [x for x in vars(moved).values() if isinstance(x, Tensor)]
    assert len(tensors) == 4
    assert all(x.is_meta for x in tensors)


def test_a_gbuffer_is_pinned_as_the_data_loader_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    """There is no page-locked memory without a GPU: what is called stands for it."""
    from torch.utils.data._utils.pin_memory import pin_memory

    pinned: list[tuple[int, ...]] = []

    def pin(tensor: Tensor, *device: object) -> Tensor:
        pinned.append(tuple(tensor.shape))
        return tensor.clone()

    monkeypatch.setattr(Tensor, "pin_memory", pin)
    given = scene()
    found = pin_memory([given])[0]
    assert isinstance(found, rt.GBuffer)
    assert found.normal is not given.normal
    assert sorted(pinned) == [(1, 1, 4, 5), (1, 3, 4, 5), (1, 3, 4, 5), (3,)]
    assert torch.equal(found.normal, given.normal)
