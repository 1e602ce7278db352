"""What the engine says to a Dask scheduler: connecting, bringing an order to the workers, sending
tasks, and who is there."""

from __future__ import annotations

import logging
import re
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import replace
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from raden_torch.errors import InputError
from raden_torch.packages import require
from raden_torch.sequences.cluster_plugin import fit_workers, plugin_with, unfit_for
from raden_torch.sequences.cluster_worker import do_item
from raden_torch.sequences.job import Outcome, message_of

if TYPE_CHECKING:
    from distributed import Client, Future

_ADDRESS = re.compile(r"(tcp|tls|ws|wss|ucx)://[^\s/]+:\d{1,5}")
_SAID = 3
"""Workers that are named of those that are not fit."""


class Lost(Exception):
    """The scheduler went away."""


@contextmanager
def connected(scheduler: str, timeout_s: float) -> Iterator[Client]:
    """A client, without the library's own messages.

    Raises:
        InputError: no scheduler there within the timeout, or no address.
    """
    require("clusters", "cluster")
    if not _ADDRESS.fullmatch(scheduler):
        raise InputError(f"scheduler: expected an address as tcp://host:8786, got {scheduler}")
    with warnings.catch_warnings():
        # both packages import their optional parts, and compare versions, with warnings; ours are
        # compared by `Machine`
        warnings.simplefilter("ignore")
        from distributed import Client

        with _silent():
            try:
                client = Client(scheduler, timeout=timeout_s, set_as_default=False)
            except OSError:
                raise InputError(
                    f"{scheduler}: expected a Dask scheduler, got no answer in {timeout_s:g} s"
                ) from None
            try:
                yield client
            finally:
                with suppress(Exception):
                    client.close(timeout=2)


@contextmanager
def _silent() -> Iterator[None]:
    """Without what the library logs: each part of it has a level and a handler of its own."""
    loggers = [logging.getLogger(name) for name in logging.root.manager.loggerDict]
    levels = {each: each.level for each in loggers if each.name.partition(".")[0] == "distributed"}
    for each in levels:
        each.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for each, level in levels.items():
            each.setLevel(level)


class RunOnCluster(AbstractContextManager["RunOnCluster"]):
    """A run's order at the workers of a scheduler, from entering to leaving.

    Args:
        name: of the run, which no other has.
        order: a pickled `Order`.
        say: called with a line about workers.
    """

    def __init__(
        self, client: Client, name: str, order: bytes, say: Callable[[str], object]
    ) -> None:
        self._client, self._name, self._order, self._say = client, name, order, say
        self.scheduler = str(client.scheduler.address) if client.scheduler else ""
        self._workers = dict[str, float]()
        self._looked_at = 0.0
        self._futures: set[Future[Any]] = set()

    def __enter__(self) -> Self:
        with _or_lost(self._client):
            self._client.register_plugin(plugin_with(self._order), name=self._name)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._client.status == "running":
            with suppress(Exception):
                self._client.cancel(list(self._futures), force=True)
                self._client.unregister_worker_plugin(self._name)

    @property
    def slots(self) -> int:
        """Threads of all fit workers."""
        return int(sum(self._workers.values()))

    def await_workers(self, wait_s: float) -> None:
        """Until one is fit.

        Raises:
            InputError: all that are there are not, or there is none within `wait_s`.
            Lost: the scheduler went away.
        """
        latest = time.monotonic() + wait_s
        told = False
        while True:
            self.look(0)
            unfit = self._unfit()
            if self.slots:
                self._say(f"workers: {len(self._workers)}, threads: {self.slots}")
                for line in _told_of(unfit):
                    self._say(f"left out: {line}")
                return
            if unfit:
                raise InputError(
                    f"{self.scheduler}: expected workers that compute as this machine does and "
                    f"see its folders, got none of {len(unfit)}: {'; '.join(_told_of(unfit))}"
                )
            if time.monotonic() > latest:
                raise InputError(
                    f"{self.scheduler}: expected a worker within {wait_s:g} s, got none; start "
                    f"some by `dask worker {self.scheduler}`"
                )
            if not told:
                self._say(f"{self.scheduler}: no worker yet; waiting up to {wait_s:g} s")
                told = True
            time.sleep(0.5)

    def look(self, after_s: float) -> bool | None:
        """Ask who is there, unless that was done less than `after_s` ago.

        Returns:
            Whether a worker was lost since the last time; None if it was not asked.

        Raises:
            Lost: the scheduler went away.
        """
        if self._client.status != "running":
            raise Lost
        if time.monotonic() - self._looked_at < after_s:
            return None
        with _or_lost(self._client):
            there = self._client.run_on_scheduler(fit_workers(self._name))
        gone = self._workers.keys() - there.keys()
        self._workers, self._looked_at = there, time.monotonic()
        for address in sorted(gone):
            self._say(f"{address}: the worker was lost; what it had begun is done again")
        return bool(gone)

    def send(self, item: Any) -> Future[Any]:
        """An item on its way to a fit worker."""
        with _or_lost(self._client):
            future = self._client.submit(
                do_item, self._name, item, pure=False, resources={self._name: 1}
            )
        self._futures.add(future)
        return future

    def outcome(self, future: Future[Any], item: Any) -> Outcome[Any]:
        """Of a future that is done.

        Raises:
            Lost: the scheduler went away.
            InputError: what the job's `prepare` raised.
        """
        from distributed import KilledWorker

        self._futures.discard(future)
        if future.status == "cancelled":
            raise Lost
        if future.status == "finished":
            with _or_lost(self._client):
                return replace(future.result(), item=item)
        error = future.exception()
        if isinstance(error, InputError):
            raise error
        if isinstance(error, KilledWorker):
            return Outcome(item, "failed", "every worker that began it was lost")
        return Outcome(item, "failed", message_of(error))

    def _unfit(self) -> dict[str, str]:
        """Why, by the workers' addresses."""
        with _or_lost(self._client):
            reasons = self._client.run(unfit_for(self._name), on_error="return")
        return {k: v for k, v in reasons.items() if isinstance(v, str) and v}


def _told_of(unfit: dict[str, str]) -> list[str]:
    lines = [f"{address}: {why}" for address, why in sorted(unfit.items())]
    more = len(lines) - _SAID
    return [*lines[:_SAID], *([f"and {more} more"] if more > 0 else [])]


@contextmanager
def _or_lost(client: Client) -> Iterator[None]:
    """What fails in the block because the scheduler went away is `Lost`."""
    from concurrent.futures import CancelledError

    from distributed.comm.core import CommClosedError

    try:
        yield
    except (CommClosedError, CancelledError, OSError, TimeoutError):
        raise Lost from None
    except Exception:
        if client.status == "running":
            raise
        raise Lost from None
