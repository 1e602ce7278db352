"""The colorimeters' protocols as conversations, and what a bad line makes of them."""

from __future__ import annotations

import numpy as np
import pytest

from raden_torch.capture.spectrometer.cr_series import CrSeries
from raden_torch.capture.spectrometer.cs100a import Cs100a
from raden_torch.capture.spectrometer.cs2000 import PARTS, WAVELENGTHS_NM, Cs2000
from raden_torch.capture.spectrometer.drivers import open_colorimeter
from raden_torch.capture.spectrometer.ports import (
    ConnectionLostError,
    InstrumentBusyError,
    InstrumentError,
    Range,
)
from raden_torch.capture.spectrometer.rig import ColorimeterSettings
from raden_torch.capture.spectrometer.spectrum import xyz_of
from raden_torch.errors import InputError

RADIANCE = 1e-3 * (1.2 + np.sin(WAVELENGTHS_NM / 40.0))
XYZ = xyz_of(RADIANCE, WAVELENGTHS_NM)


def settings(driver: str, port: str, **changes) -> ColorimeterSettings:
    quick = {"reply_timeout_s": 0.5, "connect_timeout_s": 0.5}
    return ColorimeterSettings(driver, port, **(quick | changes))


def joined(values) -> bytes:
    return b"OK00," + ",".join(f"{v:.4e}" for v in values).encode() + b"\r\n"


# -- spectrum → XYZ ------------------------------------------------------------------------------


def test_xyz_of_one_wavelength_is_the_colour_matching_function() -> None:
    """Rationale: 1 W/(sr·m²) at 555 nm is 683 cd/m², since ȳ(555 nm) = 1."""
    line = np.zeros(401)
    line[555 - 380] = 1.0
    x, y, z = xyz_of(line, WAVELENGTHS_NM)
    assert y == pytest.approx(683.0, rel=1e-3)
    assert x == pytest.approx(683.0 * 0.512050, rel=1e-3)
    assert z == pytest.approx(683.0 * 0.005750, rel=1e-2)


def test_xyz_of_an_equal_energy_spectrum_is_neutral() -> None:
    xyz = xyz_of(np.ones(401), WAVELENGTHS_NM)
    np.testing.assert_allclose(xyz / xyz[1], 1.0, atol=2e-3)


# -- CS-2000 -------------------------------------------------------------------------------------


class Cs2000Script:
    """A CS-2000 on paper; `replies` override or, as lists, are used up one by one."""

    def __init__(self, scripted_lines, **replies: bytes) -> None:
        self.got: list[str] = []
        self.replies: dict[str, bytes | list[bytes]] = {
            "RMTS,1": b"OK00\r\n",
            "RMTS,0": b"OK00\r\n",
            "IDDR": b"OK00,CS-2000   ,2,10001234\r\n",
            "MEAS,1": b"OK00,000\r\nOK00\r\n",
            "MEAS,0": b"OK00\r\n",
            "MEDR,0,0,1": b"OK00,0,0,000859000,1,0,0,0,00\r\n",
            "MEDR,2,0,1": joined(XYZ),
        }
        start = 0
        for n, count in PARTS:
            self.replies[f"MEDR,1,0,{n}"] = joined(RADIANCE[start : start + count])
            start += count
        self.instrument = scripted_lines(self._reply)

    def _reply(self, line: str) -> bytes:
        self.got.append(line)
        reply = self.replies.get(line, b"ER00\r\n")
        if isinstance(reply, list):
            return reply.pop(0) if len(reply) > 1 else reply[0]
        return reply

    def open(self, **changes) -> Cs2000:
        return Cs2000(settings("cs2000", self.instrument.port, **changes))


@pytest.fixture
def cs2000(scripted_lines) -> Cs2000Script:
    return Cs2000Script(scripted_lines)


def test_cs2000_conversation(cs2000: Cs2000Script) -> None:
    meter = cs2000.open()
    assert meter.identity == "Konica Minolta CS-2000A, serial number 10001234"
    reading = meter.measure()
    assert reading.range is Range.OK
    assert reading.integration_s == pytest.approx(0.859)
    assert reading.wavelengths_nm is not None
    assert reading.radiance is not None
    np.testing.assert_allclose(reading.radiance, RADIANCE, rtol=1e-4)
    np.testing.assert_allclose(reading.xyz, XYZ, rtol=1e-4)
    assert "speed mode 0" in meter.status()
    meter.close()
    spectrum = [f"MEDR,1,0,{n}" for n, _ in PARTS]
    expected = ["RMTS,1", "IDDR", "MEAS,1", "MEDR,0,0,1", "MEDR,2,0,1", *spectrum, "MEDR,0,0,1"]
    assert cs2000.got == [*expected, "RMTS,0"]


@pytest.mark.parametrize("first", [b"OK00\r\n", b"ER02\r\n", b"OK00,CS-2000,2,1\xff0001\r\n"])
def test_cs2000_a_reply_to_a_killed_program_is_not_its_identity(
    cs2000: Cs2000Script, first: bytes
) -> None:
    """Rationale: a resumed scan must find the identity that it began with."""
    cs2000.replies["IDDR"] = [first, b"OK00,CS-2000   ,2,10001234\r\n"]
    meter = cs2000.open()
    assert meter.identity == "Konica Minolta CS-2000A, serial number 10001234"
    meter.close()


def test_cs2000_without_the_spectrum(cs2000: Cs2000Script) -> None:
    meter = cs2000.open(spectrum=False)
    reading = meter.measure()
    assert reading.radiance is None
    np.testing.assert_allclose(reading.xyz, XYZ, rtol=1e-4)
    assert not any(line.startswith("MEDR,1") for line in cs2000.got)
    meter.close()


@pytest.mark.parametrize("reply", [b"ER10\r\n", b"OK00,000\r\nER10\r\n"])
def test_cs2000_over_range(cs2000: Cs2000Script, reply: bytes) -> None:
    cs2000.replies["MEAS,1"] = reply
    meter = cs2000.open()
    reading = meter.measure()
    assert reading.range is Range.OVER
    assert np.isnan(reading.xyz).all()
    meter.close()


def test_cs2000_too_dark_for_a_value(cs2000: Cs2000Script) -> None:
    cs2000.replies["MEDR,2,0,1"] = b"OK00,-9.9999e+09,1.0000e-03,-9.9999e+09\r\n"
    meter = cs2000.open()
    reading = meter.measure()
    assert reading.range is Range.UNDER
    assert np.isnan(reading.xyz).all()
    meter.close()


def test_cs2000_errors(cs2000: Cs2000Script) -> None:
    meter = cs2000.open()
    cs2000.replies["MEAS,1"] = b"ER02\r\n"
    with pytest.raises(InstrumentBusyError, match="ER02: it is busy"):
        meter.measure()
    cs2000.replies["MEAS,1"] = b"OK00,000\r\nER51\r\n"
    with pytest.raises(InstrumentError, match="ER51: its temperature"):
        meter.measure()
    cs2000.replies["MEAS,1"] = b""
    with pytest.raises(ConnectionLostError, match="no reply in time to 'MEAS,1'"):
        meter.measure()
    assert cs2000.got[-1] == "MEAS,0"  # it is not left measuring
    meter.close()


GOOD = joined(XYZ)


@pytest.mark.parametrize(
    "bad",
    [
        b"OK00,nan,1.0,1.0\r\n",
        b"OK00,1e999,1.0,1.0\r\n",
        b"OK00,1.0,1.0\r\n",
        b"OK00,1.0,1.0,1.0,1.0\r\n",
        b"OK00,1.0,x,1.0\r\n",
        b"OK0\xff0,1.0,1.0,1.0\r\n",
        b"OK00,1.2\xff4,1.0,1.0\r\n",
        b"garbage\r\n" + GOOD,
        b"\xff\xfe" + GOOD,
        GOOD.replace(b".", b"1", 1),  # a digit for the point: only the spectrum can tell
    ],
)
def test_cs2000_asks_again_for_a_garbled_value(cs2000: Cs2000Script, bad: bytes) -> None:
    cs2000.replies["MEDR,2,0,1"] = [bad, GOOD]
    meter = cs2000.open()
    np.testing.assert_allclose(meter.measure().xyz, XYZ, rtol=1e-4)
    meter.close()


@pytest.mark.parametrize("bad", [b"OK\xff0,000\r\n", b"OK00,0\xff0\r\nOK00\xff\r\n", b"?\r\n"])
def test_cs2000_measures_again_where_the_replies_were_garbled(
    cs2000: Cs2000Script, bad: bytes
) -> None:
    cs2000.replies["MEAS,1"] = [bad, b"OK00,000\r\nOK00\r\n"]
    meter = cs2000.open()
    np.testing.assert_allclose(meter.measure().xyz, XYZ, rtol=1e-4)
    meter.close()


def test_cs2000_gives_up_on_nonsense(cs2000: Cs2000Script) -> None:
    meter = cs2000.open()
    cs2000.replies["MEDR,2,0,1"] = b"OK00,many,different,words\r\n"
    with pytest.raises(ConnectionLostError, match="something else than 3 numbers"):
        meter.measure()
    cs2000.replies["MEDR,2,0,1"] = joined(XYZ * 1.2)
    with pytest.raises(InstrumentError, match="17 % off its own XYZ"):
        meter.measure()
    meter.close()


def test_cs2000_another_device_or_none(scripted_lines) -> None:
    other = scripted_lines(lambda line: b"error:2\r\n")
    with pytest.raises(ConnectionLostError, match=r"no CS-2000 answered .* said 'error:2'"):
        Cs2000(settings("cs2000", other.port))
    with pytest.raises(ConnectionLostError, match="no CS-2000 answered at 9600 baud; check"):
        Cs2000(settings("cs2000", scripted_lines(lambda line: b"").port, baud=9600))


def test_cs2000_still_measuring_for_a_program_that_is_gone(cs2000: Cs2000Script) -> None:
    cs2000.replies["RMTS,1"] = [b"ER02\r\n", b"OK00\r\n"]
    meter = cs2000.open()
    assert cs2000.got[:3] == ["RMTS,1", "MEAS,0", "RMTS,1"]
    meter.reconnect()
    meter.close()


# -- CR ------------------------------------------------------------------------------------------


@pytest.fixture
def cr(scripted_lines):
    replies = {
        "RC InstrumentType": b"OK:0:RC InstrumentType:2\r\n",
        "RC Model": b"OK:0:RC Model:CR-250\r\n",
        "RC ID": b"OK:0:RC ID:A00489\r\n",
        "RC Firmware": b"OK:0:RC Firmware:1.17\r\n",
        "RS ExposureMode": b"OK:0:RS ExposureMode:Auto\r\n",
        "M": b"OK:0:M:No errors\r\n",
        "RM XYZ": b"OK:0:RM XYZ:1.737e+00,1.685e+00,1.830e+00\r\n",
    }
    instrument = scripted_lines(lambda line: replies.get(line, b"ER:-500:?:Invalid command\r\n"))
    return replies, instrument


def test_cr_conversation(cr) -> None:
    replies, instrument = cr
    meter = CrSeries(settings("cr", instrument.port))
    assert meter.identity == (
        "Colorimetry Research CR-250 spectroradiometer, A00489, firmware 1.17"
    )
    np.testing.assert_allclose(meter.measure().xyz, [1.737, 1.685, 1.830])
    assert meter.status().endswith("Auto exposure")
    replies["M"] = b"M\r\nOK:0:M:No errors\r\n"  # with the echo on
    assert meter.measure().range is Range.OK
    replies["M"] = b"ER:-305:M:Light intensity too low or unmeasurable\r\n"
    assert meter.measure().range is Range.UNDER
    replies["M"] = b"ER:-306:M:Light intensity too high\r\n"
    assert meter.measure().range is Range.OVER
    replies["M"] = b"ER:-331:M:Hardware malfunction\r\n"
    with pytest.raises(InstrumentError, match="-331: Hardware malfunction"):
        meter.measure()
    replies["M"] = b"OK:0:M:No errors\r\n"
    replies["RM XYZ"] = b"OK:0:RM XYZ:1e400,nan,3\r\n"
    with pytest.raises(ConnectionLostError, match="something else than three numbers"):
        meter.measure()
    meter.close()


def test_cr_photometers_and_strangers(cr, scripted_lines) -> None:
    replies, instrument = cr
    replies["RC InstrumentType"] = b"OK:0:RC InstrumentType:0\r\n"
    with pytest.raises(
        InstrumentError, match="expected a colorimeter that measures XYZ, got a CR photometer"
    ):
        CrSeries(settings("cr", instrument.port))
    with pytest.raises(ConnectionLostError, match="no CR instrument answered"):
        CrSeries(settings("cr", scripted_lines(lambda line: b"ER00\r\n").port))


# -- CS-100A -------------------------------------------------------------------------------------


def test_cs100a_conversation(scripted_lines) -> None:
    replies = {"MDS,04": b"OK00\r\n", "CLE": b"OK00\r\n", "MES": b"OK00,  52.3, .3127, .3290\r\n"}
    instrument = scripted_lines(lambda line: replies[line])
    meter = Cs100a(settings("cs100a", instrument.port))
    np.testing.assert_allclose(
        meter.measure().xyz, 52.3 * np.array([0.3127 / 0.329, 1, 0.3583 / 0.329])
    )
    assert "absolute mode" in meter.status()
    for reply, expected in (
        (b"ER10\r\n", Range.OVER),
        (b"ER19\r\n", Range.OVER),
        (b"OK13,0.01,.3,.3\r\n", Range.UNDER),
    ):
        replies["MES"] = reply
        reading = meter.measure()
        assert reading.range is expected
        assert np.isnan(reading.xyz).all()
    replies["MES"] = b"ER30\r\n"
    with pytest.raises(InstrumentError, match="ER30, its battery is empty"):
        meter.measure()
    for nonsense in (b"OK00,1,.3,0\r\n", b"OK00,nan,.3,.3\r\n", b"OK00,1\r\n"):
        replies["MES"] = nonsense
        with pytest.raises(ConnectionLostError, match="something else than Y, x, y"):
            meter.measure()
    meter.close()
    assert instrument.received.startswith(b"MDS,04\r\nCLE\r\nMES\r\n")


def test_cs100a_strangers(scripted_lines) -> None:
    with pytest.raises(ConnectionLostError, match="no CS-100A answered at 4800 baud 7E2"):
        Cs100a(settings("cs100a", scripted_lines(lambda line: b"ok\r\n").port, reply_timeout_s=0.1))


def test_a_driver_that_nobody_brought() -> None:
    with pytest.raises(
        InputError, match=r"driver: expected one of cs2000, cr, cs100a.*, got 'dds5000'"
    ):
        open_colorimeter(settings("dds5000", "/dev/null"))
