"""Ctrl-C, SIGTERM and a closed terminal as one exception, so that everything is cleaned up."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_CLEANING_UP_S = 10.0
_IMPORTING_S = 10.0
_AGAIN_S = 0.05


class Interrupted(BaseException):
    """Ctrl-C, or a signal that asks the process to end; `str` is the signal's name."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.exit_code = 128 + number


@contextmanager
def signals_interrupt() -> Iterator[None]:
    """SIGINT, SIGTERM and SIGHUP raise `Interrupted` in the block.

    While modules are imported it waits for their end, at most 10 seconds: an exception that passes
    through a library's C++ ends the process. A second one counts after 10 seconds: what follows
    the first is cleaning up, or stopping a stage. An error after it is its consequence, as where a
    library's import swallows it. A signal that the process was told to ignore (`nohup`) stays
    ignored.
    """
    raised_at, raised, first = -_CLEANING_UP_S, 0, 0.0

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal raised_at, raised, first
        now = time.monotonic()
        first = first or now
        if _imports(frame) and now - first < _IMPORTING_S:
            again = threading.Timer(_AGAIN_S, _to_main_thread, (number,))
            again.daemon = True
            again.start()
            return
        if now - raised_at >= _CLEANING_UP_S:
            raised_at, raised = now, number
            raise Interrupted(number)

    before = {number: signal.getsignal(number) for number in _numbers()}
    caught = {number: old for number, old in before.items() if old is not signal.SIG_IGN}
    try:
        for number in caught:
            signal.signal(number, interrupt)
        yield
    except Exception as error:
        if raised:
            raise Interrupted(raised) from error
        raise
    finally:
        for number, handler in caught.items():
            signal.signal(number, handler)


def _to_main_thread(number: int) -> None:
    main = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main is not None:
        signal.pthread_kill(main, number)  # which wakes it, too
    else:
        signal.raise_signal(number)


def _imports(frame: FrameType | None) -> bool:
    """Whether this is part of an import."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def ignore_signals() -> None:
    """For the end of a process, when the work is done and what is left takes a moment."""
    for number in _numbers():
        signal.signal(number, signal.SIG_IGN)


def _numbers() -> list[int]:
    names = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
    return [getattr(signal, name) for name in names if hasattr(signal, name)]
