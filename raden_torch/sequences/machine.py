"""Which programs a machine computes with, and what they make of a fixed problem: two machines whose
answers agree write the same bytes."""

from __future__ import annotations

import hashlib
import platform
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

import raden_torch


@dataclass(frozen=True)
class Machine:
    """What decides the bytes that a machine writes.

    Attributes:
        raden_torch: the hash of its source, since two checkouts have one version number.
        answer: the hash of a small fit and picture, which the instruction set decides, too.
    """

    python: str
    raden_torch: str
    torch: str
    numpy: str
    scipy: str
    answer: str

    def difference(self, other: Machine, *, answers: bool = True) -> str:
        """In words, what is not the same here as on `other`; empty if all is.

        Args:
            answers: whether other bytes are a difference.
        """
        mine, theirs = asdict(self), asdict(other)
        names = [name for name in mine if name != "answer" and mine[name] != theirs[name]]
        if names:
            return ", ".join(f"{name} {mine[name]} (here {theirs[name]})" for name in names)
        if answers and self.answer != other.answer:
            return "another instruction set, whose results differ in their last bits"
        return ""


@cache
def this_machine() -> Machine:
    """The machine that runs this process; takes a second the first time."""
    return Machine(
        platform.python_version().rpartition(".")[0],
        _source_hash(),
        version("torch"),
        version("numpy"),
        version("scipy"),
        _answer(),
    )


def _source_hash() -> str:
    digest = hashlib.sha256()
    folder = Path(raden_torch.__file__).parent
    for path in sorted(folder.rglob("*.py")):
        digest.update(f"{path.relative_to(folder).as_posix()}\0".encode())
        digest.update(path.read_bytes())
    return f"{version('raden_torch')}+{digest.hexdigest()[:8]}"


def _answer() -> str:
    """Of a fit and of a picture of its model, as frames and shells are made."""
    import torch
    from threadpoolctl import threadpool_limits

    from raden_torch.brdf.fitting.fit import fit
    from raden_torch.brdf.shading.gbuffer import GBuffer
    from raden_torch.brdf.shading.lights import DirectionalLight
    from raden_torch.brdf.shading.shade import shade
    from raden_torch.measurement import BrdfMeasurement

    box = np.linspace(0, 70, 5), np.linspace(-70, 70, 9), np.linspace(-70, 70, 9)
    a, r, t = (x.ravel() for x in np.meshgrid(*box, indexing="ij"))
    off = np.deg2rad(np.hypot((r - a) / 2, t))
    values = 20 + 80 * np.exp(-((off / 0.3) ** 2))[:, None] * np.array([0.8, 1.0, 1.2])
    with threadpool_limits(1):  # as fast as many, and not waiting for cores that others use
        model = fit(BrdfMeasurement(a, r, t, values), interpolation="trilinear").model
    x = torch.linspace(-0.6, 0.6, 64)
    normal = torch.stack([x.expand(64, 64), x[:, None].expand(64, 64), torch.ones(64, 64)])[None]
    lamp = DirectionalLight((1.0, 1.0, 2.0))
    with torch.no_grad():
        image = shade(model, GBuffer(normal, (0.0, 0.0, 1.0)), [lamp])
        shown = image.clamp_min(0) ** (1 / 2.4)
    digest = hashlib.sha256()
    for tensor in (*model.state_dict().values(), image, shown):
        digest.update(tensor.numpy().tobytes())
    return digest.hexdigest()[:16]
