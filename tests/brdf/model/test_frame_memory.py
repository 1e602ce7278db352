"""What evaluating a frame takes beside its inputs, on the fused kernel's path."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from raden_torch.brdf.model import simd

MEASURED = """
import sys, torch
import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable

def peak():  # of this process; ru_maxrss would begin with the parent's
    with open("/proc/self/status") as status:
        return next(1024 * int(line.split()[1]) for line in status if line.startswith("VmHWM"))

diffuse = CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.tensor([0.5, 1.0, 2.0]))
table = ReflectanceTable(torch.rand(8, 15, 15, 3), (0.0, -70.0, -70.0), (10.0, 10.0, 10.0))
model = rt.RadenBrdf(diffuse, table)
lamps = [rt.DirectionalLight((0.3, 0.2, 1.0)), rt.PointLight((0.0, 0.0, 3.0))]

def frame(height, width):
    light, view, normal = (torch.rand(1, 3, height, width) for _ in range(3))
    before = peak()
    with torch.no_grad():
        if sys.argv[1] == "model":
            image = model(normal, light, view)
        else:
            image = rt.shade(model, rt.GBuffer(normal, view, light, mask=view[:, :1]), lamps)
    return (peak() - before) / (image.numel() * image.element_size())

frame(64, 64)  # the threads and their stacks
print(frame(2160, 3840))
"""


@pytest.mark.slow
@pytest.mark.skipif(not simd.LEVELS, reason="the kernel was not built here")
@pytest.mark.skipif(sys.platform != "linux", reason="the high-water mark is read from /proc")
@pytest.mark.parametrize("form", ["model", "shade"])
def test_a_frame_takes_at_most_a_fifth_more_than_its_output(form) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", MEASURED, form],
        env={key: value for key, value in os.environ.items() if key != simd.VARIABLE},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert 0.9 <= float(done.stdout) <= 1.2
