"""What travels to a scheduler and its workers by value, not by name: there this package may be
missing, or older, and a worker can then say so."""

from __future__ import annotations

from typing import Any

from raden_torch.packages import require


def fit_workers(name: str) -> Any:
    """For the scheduler: threads of the workers that are fit for a run, by address."""

    def workers(dask_scheduler: Any) -> dict[str, float]:
        offered = dask_scheduler.resources.get(name, {})
        return {address: n for address, n in offered.items() if n}

    return workers


def unfit_for(name: str) -> Any:
    """For a worker: why it is not fit for a run; empty if it is."""

    def reason(dask_worker: Any) -> str:
        return getattr(dask_worker.plugins.get(name), "unfit", "") or ""

    return reason


def plugin_with(order: bytes) -> Any:
    """What brings an order to a worker."""
    require("clusters", "cluster")
    from distributed import WorkerPlugin

    class Raden(WorkerPlugin):
        def __init__(self, payload: bytes) -> None:
            self.payload, self.unfit = payload, ""

        async def setup(self, worker: Any) -> None:
            import asyncio
            from pathlib import Path

            self.name = next(name for name, plugin in worker.plugins.items() if plugin is self)
            try:
                from raden_torch.sequences.cluster_worker import open_station

                folder = Path(worker.local_directory)
                await asyncio.to_thread(open_station, self.name, self.payload, folder)
            except Exception as error:  # it waits for other work
                self.unfit = str(error) or type(error).__name__
            else:
                await worker.set_resources(**{self.name: worker.state.nthreads})
            finally:
                self.payload = b""

        async def teardown(self, worker: Any) -> None:
            if self.unfit:
                return
            from raden_torch.sequences.cluster_worker import close_station

            close_station(self.name)
            await worker.set_resources(**{self.name: 0})

    return Raden(order)
