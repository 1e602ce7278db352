"""The GRBL driver: against the simulated controller on a pty, and against scripts of its traps."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from raden_torch.capture.spectrometer.grbl import GrblGoniometer
from raden_torch.capture.spectrometer.grbl_line import parse_status
from raden_torch.capture.spectrometer.ports import (
    ConnectionLostError,
    InstrumentError,
    MotionAlarmError,
    Position,
    Target,
)
from raden_torch.capture.spectrometer.rig import (
    Axes,
    Axis,
    ColorimeterSettings,
    GoniometerSettings,
    Rig,
)
from raden_torch.capture.spectrometer.simulation.faults import FaultPlan
from raden_torch.capture.spectrometer.simulation.grbl_controller import GrblController
from raden_torch.errors import InputError

QUICK = {110 + i: "60000" for i in range(6)} | {120 + i: "20000" for i in range(6)}


def rig_at(port: str, letters: str = "ABC", **changes) -> Rig:
    axes = Axes(
        Axis(letters[0], (-5.0, 90.0)),
        Axis(letters[1], (-90.0, 90.0), -1, 10.0),
        Axis(letters[2], (-90.0, 90.0), 1, -5.0),
    )
    shows = {Target.SAMPLE: ("M9",), Target.WHITE: "Put the white tile in", Target.DARK: ("M8",)}
    settings = GoniometerSettings(
        "grbl",
        port,
        axes,
        approach_deg=1.0,
        settle_s=0.0,
        poll_s=0.002,
        homing_timeout_s=10.0,
        reply_timeout_s=1.0,
        connect_timeout_s=2.0,
        move_timeout_s=10.0,
        shows=shows,
    )
    return Rig("test", replace(settings, **changes), ColorimeterSettings("", ""))


def never_ask(text: str) -> None:
    raise AssertionError(f"the operator was asked: {text}")


class LiveController:
    """`GrblController` behind a pty, on a real clock that runs faster."""

    def __init__(self, scripted, time_scale: float = 20.0, **arguments) -> None:
        self.lines: list[bytes] = []
        self._scale, self._began = time_scale, time.monotonic()
        arguments.setdefault("settings", {22: "1"} | QUICK)
        self.controller = GrblController(FaultPlan({}, 0), moved=self._moved, **arguments)
        self.instrument = scripted(self._receive, self._due)

    port = property(lambda self: self.instrument.port)

    @property
    def now(self) -> float:
        return (time.monotonic() - self._began) * self._scale

    def _moved(self, segment, truth, shutter, now) -> None:
        self.truth, self.shutter = (truth if segment is None else segment.end), shutter

    def _receive(self, data: bytes) -> bytes:
        self.lines += [line for line in data.split(b"\n") if line.strip(b"?")]
        self.controller.receive(data, self.now)
        return self._due()

    def _due(self) -> bytes:
        now, said = self.now, b""
        self.controller.advance(now)
        while (message := self.controller.outbox.due(now)) is not None:
            said += message
        return said


@pytest.fixture
def live(scripted):
    return lambda **arguments: LiveController(scripted, **arguments)


@contextlib.contextmanager
def opened(rig: Rig, ask=never_ask) -> Iterator[GrblGoniometer]:
    goniometer = GrblGoniometer(rig, ask)
    yield goniometer
    goniometer.close()


# -- status reports ------------------------------------------------------------------------------


def test_status_reports_of_both_firmwares() -> None:
    plain = parse_status("<Idle|MPos:0.000,-1.500,2.000|FS:0,0>")
    assert plain is not None
    assert (plain.state, plain.machine, plain.offset) == ("Idle", (0.0, -1.5, 2.0), None)
    work = parse_status("<Hold:0|WPos:1.000,2.000,3.000,4.000|Bf:15,128|WCO:0,0,5.0,0|Ov:1,1,1>")
    assert work is not None
    assert (work.base_state, work.state, work.machine) == ("Hold", "Hold:0", None)
    assert work.offset == (0.0, 0.0, 5.0, 0.0)


@pytest.mark.parametrize(
    "line",
    [
        "",
        "ok",
        "<Idle|MPos:0.000,0.0",
        "<Idle|MPos:0.000,nan,0.000>",
        "<Idle|MPos:0.000,1e300,0.000>",
        "<Idle|MPos:0.000,inf,0>",
        "<Idle|MPos:0.0\ufffd0,0,0>",
        "<Idle|MPos:>",
        "<|MPos:0,0,0>",
        "<Idle|MPos:" + ",".join(["0"] * 2000) + ">",
    ],
)
def test_what_is_no_whole_report(line: str) -> None:
    assert parse_status(line) is None


@given(st.text(max_size=60))
def test_any_text_is_a_report_or_none(text: str) -> None:
    for line in (text, f"<{text}>", f"<Idle|MPos:{text}>"):
        status = parse_status(line)
        assert status is None or not status.machine or np.isfinite(status.machine).all()


# -- against the simulated controller ------------------------------------------------------------


def test_home_move_and_tell(live) -> None:
    controller = live()
    with opened(rig_at(controller.port)) as goniometer:
        assert "grblHAL" in goniometer.identity
        assert "simulation" in goniometer.identity
        assert not goniometer.homed
        with pytest.raises(InstrumentError, match="not homed"):
            goniometer.move(Position(10, 10, 10))
        goniometer.home()
        assert goniometer.homed
        goniometer.move(Position(45.0, 30.0, -20.0))
        assert goniometer.position() == Position(45.0, 30.0, -20.0)
        # motor = zero + direction · angle
        np.testing.assert_allclose(controller.truth[3:], [45.0, -20.0, -25.0])


def test_every_axis_arrives_from_the_same_side(live) -> None:
    controller = live()
    with opened(rig_at(controller.port)) as goniometer:
        goniometer.home()
        goniometer.move(Position(40, 20, 10))
        controller.lines.clear()
        goniometer.move(Position(30, 30, 20))  # motors: A falls, B falls, C grows
        moves = [line for line in controller.lines if line.startswith(b"G0")]
        # A and B first go 1° below; C, which comes from below anyway, waits
        assert moves == [b"G0 A29.000 B-21.000 C5.000", b"G0 A30.000 B-20.000 C15.000"]
        controller.lines.clear()
        goniometer.move(Position(31, 20, 21))
        moves = [line for line in controller.lines if line.startswith(b"G0")]
        assert moves == [b"G0 A31.000 B-10.000 C16.000"]


def test_a_feed_rate_makes_it_g1(live) -> None:
    controller = live()
    with opened(rig_at(controller.port, feed_deg_per_min=36000.0)) as goniometer:
        goniometer.home()
        goniometer.move(Position(5, -5, 5))
        assert controller.lines[-1] == b"G1 A5.000 B15.000 C0.000 F36000"


def test_out_of_reach_is_refused_before_anything_is_sent(live) -> None:
    controller = live()
    with opened(rig_at(controller.port)) as goniometer:
        goniometer.home()
        controller.lines.clear()
        for position in (Position(95, 0, 0), Position(0, 90, 0), Position(0, 0, float("nan"))):
            with pytest.raises(
                InputError, match=r"cannot go there|expected finite angles in degrees, got"
            ):
                goniometer.move(position)
        assert controller.lines == []


def test_the_operators_word_for_the_position(live) -> None:
    controller = live(settings=QUICK)  # homing is not enabled
    with opened(rig_at(controller.port)) as goniometer:
        with pytest.raises(InstrumentError, match=r"refused '\$H' \(error 5, homing is not"):
            goniometer.home()
        goniometer.assume_position(Position(0, 0, 0))
        goniometer.move(Position(20, 30, 40))
        np.testing.assert_allclose(controller.truth[3:], [20, -30, 40])
        assert goniometer.position() == Position(20, 30, 40)


def test_manual_homing_asks(live) -> None:
    asked: list[str] = []
    with opened(rig_at(live(settings=QUICK).port, homing="manual"), asked.append) as goniometer:
        goniometer.home()
        assert goniometer.homed
        assert "zero mark" in asked[0]


def test_targets_are_shown_once(live) -> None:
    controller, asked = live(), []
    with opened(rig_at(controller.port), asked.append) as goniometer:
        goniometer.home()
        goniometer.show(Target.DARK)
        goniometer.show(Target.DARK)
        assert controller.lines.count(b"M8") == 1
        assert controller.shutter
        goniometer.home()  # needs no reset: the shutter stays
        goniometer.show(Target.WHITE)
        goniometer.show(Target.WHITE)
        assert asked == ["Put the white tile in"]


def test_a_reset_switches_outputs_off_so_the_target_is_shown_again(live) -> None:
    controller = live()
    with opened(rig_at(controller.port)) as goniometer:
        goniometer.home()
        goniometer.show(Target.DARK)
        controller.instrument.say(b"ALARM:1\r\n")
        controller.controller._state = "Alarm"
        with pytest.raises(MotionAlarmError, match="alarm 1, a hard limit"):
            goniometer.move(Position(1, 1, 1))
        goniometer.home()
        goniometer.show(Target.DARK)
        assert controller.lines.count(b"M8") == 2
        assert controller.shutter


def test_stop_in_motion_keeps_the_position(live) -> None:
    """Feed hold first, then a reset: no alarm, and still homed."""
    slow = {110 + i: "600" for i in range(6)} | {120 + i: "100" for i in range(6)}
    controller = live(settings={22: "1"} | slow, time_scale=1.0)
    with opened(rig_at(controller.port)) as goniometer:
        goniometer.home()
        goniometer._line.command("G0 A90", 1.0)
        time.sleep(0.3)
        goniometer.stop()
        assert goniometer.homed
        assert goniometer._line.status().state == "Idle"
        assert 0 < goniometer.position().incidence_deg < 60
        assert controller.truth[3] == pytest.approx(goniometer.position().incidence_deg, abs=1e-3)


def test_stop_while_homing_resets_at_once(live) -> None:
    """A hold does not stop homing, and `?` gets no answer: only the reset is left."""
    controller = live(time_scale=1.0, switches=False)
    with opened(rig_at(controller.port, homing_timeout_s=0.3)) as goniometer:
        with pytest.raises(ConnectionLostError, match=r"no reply to '\$H'"):
            goniometer.home()
        goniometer.stop()
        assert goniometer._line.status().state == "Alarm"
        assert not goniometer.homed


def test_a_program_that_was_killed_while_homing_leaves_a_usable_controller(live) -> None:
    controller = live(time_scale=1.0, switches=False)
    goniometer = GrblGoniometer(rig_at(controller.port, homing_timeout_s=0.1), never_ask)
    with pytest.raises(ConnectionLostError):
        goniometer.home()
    goniometer.close()
    with opened(rig_at(controller.port, connect_timeout_s=1.0)) as goniometer:
        assert not goniometer.homed
        assert goniometer._line.status().state == "Alarm"


def test_a_controller_that_does_not_know_its_build(scripted) -> None:
    controller = Grbl11(scripted)
    controller.replies["$I"] = b"error:3\r\n"
    with opened(rig_at(controller.instrument.port, letters="XYZ")) as goniometer:
        assert goniometer.identity == "Grbl"
        goniometer.home()


def test_a_reply_to_a_killed_program_is_not_the_build_info(scripted) -> None:
    """Rationale: a resumed scan must find the identity, and the letters, that it began with."""
    controller = Grbl11(scripted)
    controller.once["$I"] = b"ok\r\n[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n"
    with opened(rig_at(controller.instrument.port, letters="XYZ")) as goniometer:
        assert goniometer.identity == "Grbl 1.1h.20190825"
        controller.replies["M8"] = b"error:20\r\n"
        goniometer.home()
        with pytest.raises(InstrumentError, match="refused 'M8'"):  # by its own reply
            goniometer.show(Target.DARK)


def test_a_greeting_that_comes_late(scripted) -> None:
    """The first boot: `error:7`, then the greeting, maybe after the first status report."""
    controller = Grbl11(scripted)
    controller.once["$I"] = b"error:7\r\n\r\nGrbl 1.1h ['$' for help]\r\nok\r\n"
    with opened(rig_at(controller.instrument.port, letters="XYZ")) as goniometer:
        goniometer.home()
        goniometer.move(Position(10, 0, 0))


def test_after_ctrl_c_the_next_reply_is_not_taken_for_an_older_one(live) -> None:
    controller = live()
    with opened(rig_at(controller.port)) as goniometer:
        goniometer.home()
        goniometer._line._line.send(b"M9\n")  # sent, and interrupted before its ok was read
        goniometer._line._replies_due += 1
        with pytest.raises(InstrumentError, match=r"'G999' \(error 20"):
            goniometer._line.command("G999", 1.0)
        goniometer.move(Position(5, 5, 5))  # the error was cleared with $X


def test_wrong_axis_letters_are_found_at_once(live) -> None:
    with pytest.raises(InputError, match="expected axes V, got a controller with X, Y, Z, A, B, C"):
        GrblGoniometer(rig_at(live().port, letters="ABV"), never_ask)


def test_another_device_on_the_port(scripted_lines) -> None:
    instrument = scripted_lines(lambda line: b"ER00\r\n")
    instrument.say(b"ER00\r\n")
    rig = rig_at(instrument.port, connect_timeout_s=0.6)
    with pytest.raises(ConnectionLostError, match="no GRBL controller answered at 115200 baud"):
        GrblGoniometer(rig, never_ask)


def test_lost_and_found(live, scripted, tmp_path) -> None:
    first, port = live(), tmp_path / "port"
    port.symlink_to(first.port)
    goniometer = GrblGoniometer(rig_at(str(port)), never_ask)
    goniometer.home()
    port.unlink()
    first.instrument.unplug()
    with pytest.raises(ConnectionLostError):
        goniometer.move(Position(1, 1, 1))
    goniometer.stop()  # safe without a line
    second = live()
    port.symlink_to(second.port)
    goniometer.reconnect()
    assert not goniometer.homed
    with pytest.raises(InstrumentError, match="not homed"):
        goniometer.move(Position(1, 1, 1))
    goniometer.home()
    goniometer.move(Position(1, 1, 1))
    goniometer.close()


# -- scripts of what the simulated controller does not do ----------------------------------------


class Grbl11:
    """A script of GRBL 1.1h on three axes: WPos reports with an offset, instant moves."""

    def __init__(self, scripted) -> None:
        self.state, self.offset = "Idle", np.array([0.0, 5.0, 0.0])
        self.work = -self.offset
        self.replies: dict[str, bytes] = {}
        self.once: dict[str, bytes] = {}
        self.got: list[str] = []
        self._text = ""
        self._reports = 0
        self.instrument = scripted(self._receive)

    def _receive(self, data: bytes) -> bytes:
        said = b""
        for character in data.decode("latin-1"):
            if character == "?":
                said += self._report()
            elif character == "\x18":
                self.state = "Idle"
                said += b"\r\nGrbl 1.1h ['$' for help]\r\n"
            elif character == "\n":
                said += self._line(self._text)
                self._text = ""
            else:
                self._text += character
        return said

    def _report(self) -> bytes:
        wco = f"|WCO:{','.join(f'{v:.3f}' for v in self.offset)}" if self._reports % 10 == 2 else ""
        self._reports += 1
        position = ",".join(f"{v:.3f}" for v in self.work)
        return f"<{self.state}|WPos:{position}|FS:0,0{wco}>\r\n".encode()

    def _line(self, line: str) -> bytes:
        self.got.append(line)
        if line in self.once:
            return self.once.pop(line)
        if line in self.replies:
            return self.replies[line]
        if line == "$I":
            return b"[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n"
        if line == "$H":
            self.work = -self.offset
        for word in line.split():
            if word[0] in "XYZ" and line.startswith("G0"):
                self.work["XYZ".index(word[0])] = float(word[1:])
        return b"ok\r\n"


def test_grbl_11_with_three_axes_and_a_work_offset(scripted) -> None:
    controller = Grbl11(scripted)
    with opened(rig_at(controller.instrument.port, letters="XYZ")) as goniometer:
        assert goniometer.identity == "Grbl 1.1h.20190825"
        goniometer.home()
        goniometer.move(Position(40, 30, 20))
        # machine −20 on Y is work −25: the move compensates what someone left in the controller
        assert controller.got[-1] == "G0 X40.000 Y-25.000 Z15.000"
        assert goniometer.position() == Position(40, 30, 20)


def test_an_alarm_that_comes_instead_of_ok(scripted) -> None:
    controller = Grbl11(scripted)
    with opened(rig_at(controller.instrument.port, letters="XYZ")) as goniometer:
        controller.replies["$H"] = b"ALARM:9\r\n"
        with pytest.raises(MotionAlarmError, match="alarm 9, homing did not find the switch"):
            goniometer.home()
        assert not goniometer.homed


def test_idle_elsewhere_is_not_arrival(scripted, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("raden_torch.capture.spectrometer.grbl._STALLED_S", 0.1)
    controller = Grbl11(scripted)
    with opened(rig_at(controller.instrument.port, letters="XYZ")) as goniometer:
        goniometer.home()
        controller.replies["G0 X40.000 Y-25.000 Z15.000"] = b"ok\r\n"  # and does not move
        with pytest.raises(MotionAlarmError, match=r"in state Idle, .* degrees from its target"):
            goniometer.move(Position(40, 30, 20))
        assert not goniometer.homed
        goniometer.home()
        controller.state = "Hold:0"
        with pytest.raises(MotionAlarmError, match="in state Hold:0"):
            goniometer.move(Position(40, 30, 20))


@pytest.mark.parametrize("state", ["Door:0", "Hold:0", "Check", "Sleep"])
def test_nothing_is_sent_to_wait_for_a_door_to_close(scripted, state: str) -> None:
    """Rationale: what is queued behind an open door or a hold moves when nobody expects it."""
    controller = Grbl11(scripted)
    with opened(rig_at(controller.instrument.port, letters="XYZ")) as goniometer:
        goniometer.home()
        controller.state, before = state, list(controller.got)
        with pytest.raises(MotionAlarmError, match=f"in state {state} before a move"):
            goniometer.move(Position(40, 30, 20))
        assert controller.got == before
        assert not goniometer.homed
        goniometer.home()  # a reset first
        goniometer.move(Position(40, 30, 20))


def test_a_garbled_ok_is_made_up_for_by_arrival(scripted) -> None:
    controller = Grbl11(scripted)
    with opened(rig_at(controller.instrument.port, letters="XYZ")) as goniometer:
        goniometer.home()
        line = "G0 X10.000 Y5.000 Z-5.000"
        controller.replies[line] = b"o\xffk\r\n"
        controller.work = np.array([10.0, 5.0, -5.0])
        goniometer.move(Position(10, 0, 0))
        assert controller.got[-1] == line
        controller.replies["M8"] = b"\x88k\r\n"
        with pytest.raises(ConnectionLostError, match="no reply to 'M8'"):
            goniometer.show(Target.DARK)


def test_a_controller_that_falls_silent(scripted) -> None:
    controller = Grbl11(scripted)
    rig = rig_at(controller.instrument.port, letters="XYZ", reply_timeout_s=0.2)
    with opened(rig) as goniometer:
        goniometer.home()
        controller.replies["M8"] = b""
        with pytest.raises(ConnectionLostError, match=r"no reply to 'M8' within 0\.2 s"):
            goniometer.show(Target.DARK)


def test_a_restart_by_itself_is_noticed(scripted) -> None:
    controller = Grbl11(scripted)
    with opened(rig_at(controller.instrument.port, letters="XYZ")) as goniometer:
        goniometer.home()
        controller.instrument.say(b"\r\nGrbl 1.1h ['$' for help]\r\n")
        time.sleep(0.05)
        with pytest.raises(MotionAlarmError, match="restarted by itself"):
            goniometer.move(Position(10, 0, 0))
        assert not goniometer.homed
