"""The deadline loop: whatever comes, or does not, no call outlasts its time or its memory."""

from __future__ import annotations

import itertools
import time

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from raden_torch.capture.spectrometer import serial_line
from raden_torch.capture.spectrometer.ports import ConnectionLostError
from raden_torch.capture.spectrometer.serial_line import LineSettings, SerialLine, reopen


def silent(_: bytes) -> bytes:
    return b""


def test_lines_however_they_end_and_arrive(scripted) -> None:
    instrument = scripted(silent)
    line = SerialLine(LineSettings(instrument.port))
    instrument.say(b"ok\r\n\r\nGrbl 1.1h\nhalf")
    assert line.read_line(1.0) == "ok"
    assert line.read_line(1.0) == "Grbl 1.1h"
    assert line.read_line(0.05) is None  # half a line is kept, not given
    instrument.say(b" a line\r")
    assert line.read_line(1.0) == "half a line"
    line.close()


def test_a_time_of_zero_still_takes_what_has_arrived(scripted) -> None:
    instrument = scripted(silent)
    line = SerialLine(LineSettings(instrument.port))
    assert line.read_line(0.0) is None
    instrument.say(b"ALARM:1\r\n")
    time.sleep(0.05)
    assert line.read_line(0.0) == "ALARM:1"
    line.close()


def test_noise_before_a_line_is_dropped_and_within_it_shown(scripted) -> None:
    instrument = scripted(silent)
    line = SerialLine(LineSettings(instrument.port))
    instrument.say(b"\xff\x00\x81ok\r\n1.2\xff34\r\n")
    assert line.read_line(1.0) == "ok"
    assert line.read_line(1.0) == "1.2\ufffd34"  # never the number 1.234
    line.close()


def test_an_endless_line_ends(scripted) -> None:
    instrument = scripted(lambda _: b"x" * 4096)
    line = SerialLine(LineSettings(instrument.port))
    line.send(b"?")
    instrument.say(b"x" * 4096)
    instrument.say(b"x" * 1024)
    with pytest.raises(ConnectionLostError, match=r"no line end in .* bytes"):
        line.read_line(5.0)
    line.close()


def test_an_endless_talk_ends(scripted, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_line, "MAX_UNASKED_BYTES", 20_000)
    instrument = scripted(silent)
    line = SerialLine(LineSettings(instrument.port))

    def listen() -> None:
        for _ in range(30):
            instrument.say(b"[MSG:on and on]\r\n" * 100)
            while line.read_line(0.05) is not None:
                pass

    with pytest.raises(ConnectionLostError, match="nobody asked for"):
        listen()
    line.close()


def test_line_ends_without_lines_do_not_outlast_the_deadline(scripted) -> None:
    instrument = scripted(silent)
    line = SerialLine(LineSettings(instrument.port))
    instrument.say(b"\r\n" * 1000)
    assert line.read_line(0.05) is None
    line.close()


class NothingForEver:
    """A port that returns nothing at once, for ever: one way in which a cable is pulled."""

    in_waiting = 0

    def __init__(self) -> None:
        self.reads = itertools.count()

    def read(self, _: int) -> bytes:
        next(self.reads)
        return b""

    def close(self) -> None:
        raise OSError("gone")


def test_a_port_that_returns_nothing_for_ever(scripted) -> None:
    line = SerialLine(LineSettings(scripted(silent).port))
    line.close()
    port = NothingForEver()
    line._port = port  # type: ignore[assignment]
    assert line.read_line(0.1) is None
    assert next(port.reads) < 50  # it waits between its attempts
    line.close()  # and does not raise


def test_a_pulled_cable(scripted, tmp_path) -> None:
    instrument = scripted(silent)
    path = tmp_path / "port"
    path.symlink_to(instrument.port)
    line = SerialLine(LineSettings(str(path)))
    path.unlink()
    instrument.unplug()
    with pytest.raises(ConnectionLostError, match="the connection is lost"):
        line.read_line(1.0)
    with pytest.raises(ConnectionLostError):
        reopen(line, 0.1)
    with pytest.raises(ConnectionLostError, match="the port is closed"):
        line.send(b"?")


def test_a_port_that_is_not_there(tmp_path) -> None:
    with pytest.raises(ConnectionLostError, match=r"cannot be opened.*check the port"):
        SerialLine(LineSettings(str(tmp_path / "nothing")))
    with pytest.raises(ConnectionLostError, match="cannot be opened"):
        SerialLine(LineSettings("nonsense://"))


def test_two_programs_cannot_share_a_port(scripted) -> None:
    instrument = scripted(silent)
    line = SerialLine(LineSettings(instrument.port))
    with pytest.raises(ConnectionLostError, match="no other program"):
        SerialLine(LineSettings(instrument.port))
    line.close()


def test_a_url_of_pyserial() -> None:
    line = SerialLine(LineSettings("loop://"))
    line.send(b"hello\r\n")
    assert line.read_line(1.0) == "hello"
    line.close()


def test_drain_gives_the_first_bytes_and_discards_the_rest() -> None:
    line = SerialLine(LineSettings("loop://"))
    line.send(b"Grbl 1.1h\r\n[MSG:]\r\nhalf")
    assert line.drain(0.05).startswith(b"Grbl 1.1h")
    line.send(b"ok\r\n")
    assert line.read_line(1.0) == "ok"
    line.close()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.binary(min_size=1, max_size=200), max_size=8))
def test_any_bytes_in_any_pieces(pieces: list[bytes]) -> None:
    """The lines do not depend on where the pieces were cut, and hold no line end."""
    whole, cut = SerialLine(LineSettings("loop://")), SerialLine(LineSettings("loop://"))
    whole.send(b"".join(pieces) + b"\n")
    for piece in pieces:
        cut.send(piece)
    cut.send(b"\n")

    def lines(line: SerialLine) -> list[str]:
        found = []
        while (text := line.read_line(0.0)) is not None:
            found.append(text)
        line.close()
        return found

    first, second = lines(whole), lines(cut)
    assert first == second
    assert all("\n" not in text and "\r" not in text and text for text in first)
