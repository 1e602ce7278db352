"""Instruments that follow a script, at the other end of a real pty."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Callable, Iterator

import pytest

Answer = Callable[[bytes], bytes]


class ScriptedInstrument:
    """A pty whose far end answers what arrives: `answer(bytes) -> bytes`, called for each piece.

    `tick() -> bytes` is called every few milliseconds, for what is said unasked.
    """

    def __init__(self, answer: Answer, tick: Callable[[], bytes] | None = None) -> None:
        self._answer, self._tick = answer, tick
        self._ours, theirs = os.openpty()
        tty.setraw(theirs)
        self._theirs = theirs
        self.port = os.ttyname(theirs)
        self.received = b""
        self._open = True
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def say(self, data: bytes) -> None:
        os.write(self._ours, data)

    def unplug(self) -> None:
        """The cable is pulled: reading and writing fail at the other end."""
        self._stop()
        for handle in (self._ours, self._theirs):
            os.close(handle)

    def close(self) -> None:
        if self._open:
            self.unplug()

    def _stop(self) -> None:
        self._open = False
        self._thread.join(2.0)

    def _run(self) -> None:
        while self._open:
            ready, _, _ = select.select([self._ours], [], [], 0.02 if self._tick is None else 0.002)
            if self._tick is not None and (said := self._tick()):
                os.write(self._ours, said)
            if ready:
                data = os.read(self._ours, 4096)
                self.received += data
                reply = self._answer(data)
                if reply:
                    os.write(self._ours, reply)


def by_line(replies: Callable[[str], bytes]) -> Answer:
    """An answer to whole lines, however they arrive."""
    rest = b""

    def answer(data: bytes) -> bytes:
        nonlocal rest
        rest += data
        said = b""
        while b"\n" in rest:
            line, _, rest = rest.partition(b"\n")
            said += replies(line.decode("ascii").strip())
        return said

    return answer


@pytest.fixture
def scripted() -> Iterator[Callable[..., ScriptedInstrument]]:
    made: list[ScriptedInstrument] = []

    def make(answer: Answer, tick: Callable[[], bytes] | None = None) -> ScriptedInstrument:
        made.append(ScriptedInstrument(answer, tick))
        return made[-1]

    yield make
    for instrument in made:
        instrument.close()


@pytest.fixture
def scripted_lines(scripted: Callable[..., ScriptedInstrument]):
    """As `scripted`, with a function of one line."""
    return lambda replies: scripted(by_line(replies))
