"""Where many items are done: on this machine, or on a cluster."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Literal

from cyclopts import Group, Parameter

from raden_torch.errors import InputError

if TYPE_CHECKING:
    from raden_torch.sequences.job import Engine
    from raden_torch.sequences.local import LocalEngine

_CLUSTER = Group("Many machines", sort_key=5)
_WAIT_S = 60.0


@Parameter(name="*", group=_CLUSTER)
@dataclass(frozen=True)
class EngineOptions:
    """Who does the work."""

    engine: Literal["local", "dask"] = "local"
    """dask: the workers of a Dask cluster, which see the same folders"""
    scheduler: str | None = None
    """the cluster's scheduler, as `tcp://host:8786`"""
    wait: float = _WAIT_S
    """seconds to wait for workers, and for a scheduler that went away"""
    mixed_workers: bool = False
    """also use workers whose results differ in the last bits: GPUs, which shade frames then, and
    other instruction sets"""

    def __post_init__(self) -> None:
        if (self.engine == "dask") != (self.scheduler is not None):
            raise InputError("--engine dask and --scheduler go together; give both or neither")
        if self.engine == "local" and (self.mixed_workers or self.wait != _WAIT_S):
            raise InputError("--wait and --mixed-workers: expected with --engine dask, got local")
        if not (isfinite(self.wait) and 0 <= self.wait <= 1e6):
            raise InputError(f"--wait: expected 0…1000000 seconds, got {self.wait:g}")

    def among(self, local: LocalEngine) -> Engine:
        """The engine: this one, or that of the cluster."""
        if self.scheduler is None:
            return local
        from raden_torch.packages import require

        require("clusters", "cluster")
        from raden_torch.sequences.cluster import DaskEngine

        return DaskEngine(self.scheduler, self.wait, self.mixed_workers, _say)


ON_THIS_MACHINE = EngineOptions()


def _say(line: str) -> None:
    print(f"raden: {line}", file=sys.stderr, flush=True)
