"""A rig file: everything that is wrong is found before a port is opened, in one line."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import raden_torch as rt
from raden_torch.capture.spectrometer.ports import Position, Target
from raden_torch.capture.spectrometer.rig_config import load_rig
from raden_torch.errors import InputError

RIG = """
[goniometer]
driver = "grbl"
port = "/dev/ttyUSB0"
approach_deg = 1.0

[goniometer.axes.incidence]
letter = "A"
limits_deg = [-2, 75]

[goniometer.axes.receiving]
letter = "B"
direction = -1
zero_deg = 12.5
limits_deg = [-75, 75]

[goniometer.axes.tilt]
letter = "C"
limits_deg = [-72, 72]

[goniometer.show]
sample = ["M9", "G0 X0"]
white = "manual"
dark = ["M8"]

[colorimeter]
driver = "cs2000"
port = "/dev/ttyACM0"

[obstruction]
angle_deg = 8

[white]
reflectance_factor = 98.5
"""


@pytest.fixture
def rig_file(tmp_path: Path):
    def write(text: str | bytes = RIG) -> Path:
        path = tmp_path / "rig.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def test_a_rig_is_read(rig_file) -> None:
    rig = load_rig(rig_file())
    receiving = rig.goniometer_settings.axes["receiving"]
    assert (receiving.letter, receiving.direction, receiving.zero_deg) == ("B", -1, 12.5)
    assert receiving.angle(receiving.motor(33.0)) == 33.0
    assert rig.goniometer_settings.shows[Target.DARK] == ("M8",)
    assert "white reference" in rig.goniometer_settings.shows[Target.WHITE]
    assert rig.colorimeter_settings.spectrum
    assert not rig.simulated
    np.testing.assert_allclose(
        rig.white.xyz(Position(45, 0, 0)), 0.985 * np.array([95.047, 100, 108.883])
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'letter = "B"',
            'letter = "A"',
            r"receiving.letter: expected a letter of its own, got 'A', which turns incidence",
        ),
        ('letter = "B"', 'letter = "a"', r"got 'A', which turns incidence already"),
        ('letter = "B"', 'letter = "Q"', r"expected one of X, Y, Z, .*, got 'Q'"),
        (
            "[-75, 75]",
            "[75, -75]",
            r"receiving.limits_deg: expected the lower limit first, got \[75, -75\]",
        ),
        (
            "[-75, 75]",
            "[-75]",
            r"limits_deg: expected 2 numbers in -180…180, got \[-75\]",
        ),
        ("[-75, 75]", "[0, 0.5]", r"receiving.limits_deg: 0…0.5 leaves no room for approach_deg"),
        (
            "[-75, 75]",
            "[nan, 75]",
            r"limits_deg\[0\]: expected a number in -180…180, got nan",
        ),
        (
            "limits_deg = [-72, 72]",
            "",
            r"goniometer.axes.tilt.limits_deg: expected 2 numbers in -180…180, got none",
        ),
        ("direction = -1", "direction = 2", r"direction: expected one of -1, 1, got 2"),
        ("direction = -1", "direction = true", r"direction: expected one of -1, 1, got True"),
        (
            "zero_deg = 12.5",
            "zero_deg = 1" + "0" * 400,
            r"zero_deg: expected a number in .*, got 1000",
        ),
        ("zero_deg = 12.5", "zero_deg = 1" + "0" * 9000, r"no valid TOML"),
        ("zero_deg = 12.5", 'zero_deg = "12.5"', r"zero_deg: expected a number in .*, got '12.5'"),
        (
            'driver = "grbl"',
            'driver = "dds5000"',
            r"goniometer.driver: expected one of grbl, got 'dds5000'",
        ),
        ('driver = "grbl"', "", r"goniometer.driver: expected a text, got none"),
        ('"/dev/ttyACM0"', '"/dev/ttyUSB0"', r"colorimeter.port: the goniometer has the same"),
        (
            "approach_deg = 1.0",
            "aproach_deg = 1.0",
            r"goniometer.aproach_deg: expected one of approach_deg, ",
        ),
        (
            "approach_deg = 1.0",
            "baud = 0",
            r"goniometer.baud: expected a whole number in 300….*0",
        ),
        (
            "approach_deg = 1.0",
            "baud = 9600.5",
            r"goniometer.baud: expected a whole number in .*, got 9600.5",
        ),
        ("approach_deg = 1.0", 'homing = "G28"', r"homing: expected '\$H' or 'manual', got 'G28'"),
        (
            "98.5",
            "0.0",
            r"white.reflectance_factor: expected above 0, .* divided by it .*, got 0",
        ),
        (
            "98.5",
            "0.985",
            r"white.reflectance_factor: expected percent \(.* 100 here, .*, got 0.985",
        ),
        ("98.5", "-3", r"white.reflectance_factor: expected a number in 0…1000, got -3"),
        (
            "reflectance_factor = 98.5",
            "",
            r"white.reflectance_factor: expected this or `file` .*, got neither",
        ),
        (
            "98.5",
            '98.5\nfile = "tile.csv"',
            r"reflectance_factor: expected this or `file` .*, got both",
        ),
        (
            "reflectance_factor = 98.5",
            'file = "tile.csv"',
            r"tile.csv: expected a measurement CSV, got an error: No such file",
        ),
        ("98.5", "98.5\ngeometry_deg = [80, 0, 0]", r"white.geometry_deg: out of reach: incidence"),
        ("98.5", "98.5\ngeometry_deg = [3, 0, 0]", r"out of reach: the detector hides the lamp"),
        (
            '"M9", "G0 X0"',
            '"G0 A10"',
            r"show.sample: expected .*, got 'G0 A10', which would drive A past them",
        ),
        (
            '"M9", "G0 X0"',
            '"G92 X0"',
            r"show.sample: expected .*, got 'G92 X0', which changes coordinates",
        ),
        ('"M9", "G0 X0"', '"G10L2P1X5"', r"changes coordinates"),
        ('"M9", "G0 X0"', '"$H"', r"show.sample: expected G-code words only, .*, got '\$H'"),
        ('"M9", "G0 X0"', '"M9\\nG0 X0"', r"G-code words only"),
        (
            '"M9", "G0 X0"',
            "3",
            r"show.sample\[0\]: expected a text, got 3",
        ),
        (
            "angle_deg = 8",
            "angle_deg = 95",
            r"obstruction.angle_deg: expected a number in 0…90, got 95",
        ),
        (
            "[obstruction]",
            "[obstrucktion]",
            r"obstrucktion: expected one of .*, got 'obstrucktion'",
        ),
        ("[white]\n", "[white\n", r"no valid TOML"),
        ("[colorimeter]", "colorimeter = 3\n[other]", r"other|colorimeter"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(rig_file, old: str, new: str, message: str) -> None:
    assert RIG.count(old) == 1
    path = rig_file(RIG.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        load_rig(path)
    assert str(path.parent) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


def test_files_that_are_no_rig(rig_file, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        load_rig(tmp_path / "missing.toml")
    with pytest.raises(InputError, match="not UTF-8"):
        load_rig(rig_file(b"\xff\xfe\x00"))
    with pytest.raises(InputError, match="over 1000000 bytes"):
        load_rig(rig_file(b"#" * 1_000_001))
    with pytest.raises(InputError, match="no valid TOML"):
        load_rig(rig_file("a = " + "[" * 50_000))


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_mutilated_file_is_read_or_refused(rig_file, data) -> None:
    """Nothing but InputError comes out, whatever line is dropped, doubled or changed."""
    lines = RIG.splitlines()
    i = data.draw(st.integers(0, len(lines) - 1))
    lines[i] = data.draw(
        st.one_of(
            st.just(""),
            st.text(max_size=30),
            st.just(lines[i] + "\n" + lines[i]),
            st.builds(
                lambda v: lines[i].partition("=")[0] + "= " + v,
                st.sampled_from(["1e999", "nan", "-1", "[]", "{}", '""', "2020-01-01", "true"]),
            ),
        )
    )
    with contextlib.suppress(InputError):
        load_rig(rig_file("\n".join(lines).encode("utf-8", "surrogatepass")))


def test_reach(rig_file) -> None:
    rig = load_rig(rig_file())
    assert rig.reachable(Position(45, 45, 0)) is None
    assert re.search("outside its limits -2…75", rig.reachable(Position(80, 0, 0)) or "")
    # the approach comes from below the motor's target: with direction −1 that is a larger angle
    assert rig.reachable(Position(45, -75, 0)) is None
    assert re.search("approached from 75.5", rig.reachable(Position(45, 74.5, 0)) or "")
    assert re.search("approached from -72.5", rig.reachable(Position(45, 20, -71.5)) or "")
    assert "hides the lamp" in (rig.reachable(Position(30, -25, 0)) or "")
    assert rig.out_of_reach(Position(30, -25, 0)) is None  # it may pass there
    assert "finite" in (rig.reachable(Position(float("nan"), 0, 0)) or "")


def test_a_detector_that_would_touch_the_lamp_keeps_to_its_side(rig_file) -> None:
    rig = load_rig(rig_file(RIG.replace("angle_deg = 8", "angle_deg = 8\ncollides = true")))
    assert rig.reachable(Position(30, -15, 0)) is None
    assert "would touch the lamp" in (rig.out_of_reach(Position(30, -40, 0)) or "")
    # 8.5 itself would do, but its approach goes down to 7.5
    assert "comes down to 7.5" in (rig.out_of_reach(Position(20, -11.5, 0)) or "")


def test_the_white_references_own_measurement(rig_file, tmp_path: Path) -> None:
    a, r, t = (x.ravel() for x in np.meshgrid([30.0, 45.0], [0.0, 45.0], [0.0], indexing="ij"))
    xyz = np.stack([90 + a / 10, 95 + a / 10, 100 + a / 10], axis=1)
    rt.BrdfMeasurement(a, r, t, xyz).save(tmp_path / "tile.csv")
    rig = load_rig(rig_file(RIG.replace("reflectance_factor = 98.5", 'file = "tile.csv"')))
    np.testing.assert_allclose(rig.white.xyz(Position(31, 44, 0)), [93, 98, 103])
    with pytest.raises(InputError, match="no reading of the white reference within 5"):
        rig.white.xyz(Position(60, 0, 0))
    a, r, t = (x.ravel() for x in np.meshgrid(*[[30.0, 40.0, 50.0]] * 3, indexing="ij"))
    rt.BrdfMeasurement(a, r, t, xyz[:1] + (a + 2 * r + 3 * t)[:, None]).save(tmp_path / "tile.csv")
    # a new version of the file; a grid, so linear between its cells
    found = rig.white.xyz(Position(41, 32, 43))
    np.testing.assert_allclose(found, xyz[0] + 41 + 64 + 129)
    (tmp_path / "tile.csv").write_text("not a measurement")
    with pytest.raises(InputError, match="not the project's CSV"):
        load_rig(rig_file(RIG.replace("reflectance_factor = 98.5", 'file = "tile.csv"')))


def test_the_shared_spectralon_as_white_reference(rig_file, shared: Path) -> None:
    tile = shared / "data" / "measured_brdf" / "spectralon_rgb.csv"
    text = RIG.replace("reflectance_factor = 98.5", f'file = "{tile}"')
    white = load_rig(rig_file(text)).white.xyz(Position(45, 0, 0))
    assert 70 < white[1] < 120


def test_what_a_rig_states_of_its_uncertainty(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    assert load_rig(path).stated.zero_std_deg == (0.05, 0.05, 0.05)
    assert load_rig(path).stated.position_std_deg == (0.02, 0.02, 0.02)
    stated = 'letter = "A"\nzero_std_deg = 0.1\nposition_std_deg = 0.0'
    meter = 'driver = "cs2000"\nwavelength_std_nm = 0.2\nxyz_std = 0.01'
    path.write_text(RIG.replace('letter = "A"', stated).replace('driver = "cs2000"', meter))
    found = load_rig(path).stated
    assert found.zero_std_deg == (0.1, 0.05, 0.05)
    assert found.position_std_deg == (0.0, 0.02, 0.02)
    assert (found.wavelength_std_nm, found.xyz_std) == (0.2, 0.01)
    path.write_text(RIG.replace('letter = "A"', 'letter = "A"\nzero_std_deg = -1'))
    with pytest.raises(
        InputError, match=r"incidence.zero_std_deg: expected a number in 0…10, got -1"
    ):
        load_rig(path)
