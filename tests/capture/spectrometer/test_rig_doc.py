"""docs/rig.md: its rig file is a rig file, and its driver drives."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.spectrometer.drivers import COLORIMETER_GROUP
from raden_torch.capture.spectrometer.ports import ConnectionLostError, Target
from raden_torch.capture.spectrometer.rig_config import load_rig, tomllib

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "rig.md").read_text(encoding="utf-8")


def block(kind: str, containing: str) -> str:
    blocks = re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL)
    return next(text for text in blocks if containing in text)


@pytest.fixture
def example(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(block("toml", "[goniometer]"), encoding="utf-8")
    return path


def test_the_example_is_a_rig(example: Path) -> None:
    rig = load_rig(example)
    assert rig.name == "goniometer, room 3"
    assert rig.goniometer_settings.shows[Target.WHITE] == ("M9", "G0 X100")
    assert rig.obstruction.angle_deg == 8
    assert rig.white.relative_std == 0.005


def test_the_driver_is_found_and_works(
    example: Path, tmp_path: Path, scripted_lines, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Installed as any package is: a module, and the entry points of its metadata."""
    (tmp_path / "acme_meter.py").write_text(block("python", "acme_meter"), encoding="utf-8")
    points = tomllib.loads(block("toml", "entry-points"))["project"]["entry-points"]
    info = tmp_path / "acme_meter-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-meter\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        f"[{COLORIMETER_GROUP}]\nacme = {points[COLORIMETER_GROUP]['acme']}\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    replies = {"*IDN?": b"M1\r\n", "READ?": b"10.5 11 12.25\r\n", "STATUS?": b"fine\r\n"}
    instrument = scripted_lines(lambda line: replies[line])
    text = (
        example.read_text().replace('"cs2000" ', '"acme"').replace("/dev/ttyACM0", instrument.port)
    )
    example.write_text(text.replace("spectrum = true", "reply_timeout_s = 0.2"))
    meter = load_rig(example).colorimeter()
    np.testing.assert_array_equal(meter.measure().xyz, [10.5, 11, 12.25])
    assert meter.status() == "Acme M1: fine"
    for nonsense in (b"1 2\r\n", b"nan 1 1\r\n", b"1 \xff 3\r\n", b""):
        replies["READ?"] = nonsense
        with pytest.raises(ConnectionLostError):
            meter.measure()
    replies["READ?"] = b"1 2 3\r\n"
    meter.reconnect()
    np.testing.assert_array_equal(meter.measure().xyz, [1, 2, 3])
    meter.close()
    sys.modules.pop("acme_meter")
