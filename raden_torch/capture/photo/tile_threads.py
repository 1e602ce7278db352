"""Tiles of pixels, one a thread."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch
from torch import Tensor

Result = TypeVar("Result")


def in_threads(
    solve: Callable[[Tensor], Result], tiles: Sequence[Tensor], device: torch.device
) -> Iterator[Result]:
    """The results, in order.

    A tile a thread, on the CPU: many small operators wait for each other if torch divides each of
    them among the threads, the longer the busier the machine is.
    """
    threads = torch.get_num_threads()
    if device.type != "cpu" or threads == 1:
        yield from map(solve, tiles)
        return
    pool = ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,))
    try:
        yield from pool.map(solve, tiles)
    finally:
        pool.shutdown(cancel_futures=True)
        torch.set_num_threads(threads)  # what the workers set reaches parts of torch for all
