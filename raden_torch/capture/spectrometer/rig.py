"""What a rig is made of: its axes, what it cannot reach, its white reference, its two instruments.

A `Rig` is read from a file by `rig_config.load_rig`. The structs here are tables of that file, with
the ranges that it may have; made in code, they are not checked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct
from msgspec import field as named
from msgspec.structs import force_setattr

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.ports import Colorimeter, Goniometer, Position, Target
from raden_torch.capture.spectrometer.stated_uncertainty import StatedUncertainty
from raden_torch.capture.spectrometer.white_reference import UNNAMED
from raden_torch.colorimetry import D65_XYZ
from raden_torch.schema import Text

Angle = Literal["incidence", "receiving", "tilt"]

ANGLES: tuple[Angle, Angle, Angle] = ("incidence", "receiving", "tilt")
"""The three angles of a position, in the order in which every table here keeps them."""

MANUAL: Literal["manual"] = "manual"
"""Done by the operator."""

Baud = Annotated[int, Meta(ge=300, le=4_000_000)]
Degree = Annotated[float, Meta(ge=-180, le=180)]
Spread = Annotated[float, Meta(ge=0, le=10)]
Show = Annotated[
    tuple[str, ...] | Literal["manual"], Meta(description="a list of G-code lines or 'manual'")
]

_QUESTIONS = {
    Target.SAMPLE: "Put the sample in place, with the lamp open",
    Target.WHITE: "Put the white reference in the sample's place, with the lamp open",
    Target.DARK: "Shut the lamp",
}

Ask = Callable[[str], None]
"""Shows an operator one line and returns when it has been done."""


class Axis(Struct, frozen=True, forbid_unknown_fields=True):
    """One raden angle and the rotary axis of the controller that turns it.

    motor = `zero_deg` + `direction` · angle, in degrees of the controller.

    Attributes:
        letter: the controller's letter: X, Y, Z, A, B, C, U, V or W.
        limits_deg: the soft limits, in degrees of the angle.
        direction: 1 where the angle grows with the motor, −1 where it falls.
        zero_deg: where the motor stands, after homing, when the angle is 0.
        zero_std_deg: standard uncertainty of `zero_deg` after homing.
        position_std_deg: standard deviation of where a move ends.
    """

    letter: Annotated[
        str,
        Meta(pattern=r"\A[XYZABCUVWxyzabcuvw]\Z", description="one of X, Y, Z, A, B, C, U, V, W"),
    ]
    limits_deg: tuple[Degree, Degree]
    direction: Literal[1, -1] = 1
    zero_deg: Annotated[float, Meta(ge=-3600, le=3600)] = 0.0
    zero_std_deg: Spread = 0.05
    position_std_deg: Spread = 0.02

    def __post_init__(self) -> None:
        force_setattr(self, "letter", self.letter.upper())

    def motor(self, angle_deg: float) -> float:
        return self.zero_deg + self.direction * angle_deg

    def angle(self, motor_deg: float) -> float:
        return self.direction * (motor_deg - self.zero_deg)


@dataclass(frozen=True, slots=True)
class WhiteReference:
    """The white reference and its own reflectance factor, on the scale of a perfect diffuser = 100.

    Attributes:
        factor: its reflectance factor, the same in every geometry and at every wavelength; None
            where `file` gives it.
        file: a measurement of it, in the project's CSV.
        geometry: where it is read.
        name: for reports.
        relative_std: of its reflectance factor, as its certificate states it (k = 1).
    """

    factor: float | None = 99.0
    file: Path | None = None
    geometry: Position = field(default_factory=lambda: Position(45.0, 0.0, 0.0))
    name: str = UNNAMED
    relative_std: float = 0.0

    def xyz(self, position: Position) -> Floats:
        """XYZ reflectance factor `(3,)` for D65 at `position`.

        Raises:
            InputError: the file cannot be read, or has nothing within 5° of the position.
        """
        if self.file is not None:
            from raden_torch.capture.spectrometer.white_file import xyz_at

            return xyz_at(self.file, position)
        assert self.factor is not None
        return self.factor / 100.0 * D65_XYZ


class Axes(Struct, frozen=True, forbid_unknown_fields=True):
    """The axis of each angle."""

    incidence: Axis
    receiving: Axis
    tilt: Axis

    def __getitem__(self, name: Angle) -> Axis:
        axis: Axis = getattr(self, name)
        return axis


class Shows(Struct, frozen=True, forbid_unknown_fields=True):
    """What puts each target before the instrument: lines to send, or `MANUAL`."""

    sample: Show = MANUAL
    white: Show = MANUAL
    dark: Show = MANUAL

    def __getitem__(self, target: Target) -> tuple[str, ...] | str:
        """The lines, or a text for the operator."""
        lines = getattr(self, target.value)
        return _QUESTIONS[target] if lines == MANUAL else lines


class GoniometerSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """All that a goniometer's driver needs to know. Times in seconds, angles in degrees.

    Attributes:
        port: a device ("/dev/ttyUSB0", "COM3") or a URL of pyserial ("socket://host:port").
        approach_deg: how far below its target an axis starts its last move where it would
            otherwise arrive from above: more than the backlash. 0 for none.
        feed_deg_per_min: of every move; None for the controller's own rapid rate.
        rapid_deg_per_s: that rate, for estimates of time alone.
        settle_s: how long to wait after arrival.
        homing: the command that homes; "manual" where the rig has no switches.
        shows: `show` in the file.
        poll_s: between two status requests (GRBL asks for 0.2 or more).
    """

    driver: Text
    port: Text
    axes: Axes
    baud: Baud = 115200
    approach_deg: Spread = 1.0
    feed_deg_per_min: Annotated[float, Meta(ge=1, le=1e6)] | None = None
    rapid_deg_per_s: Annotated[float, Meta(ge=1e-3, le=1e5)] = 10.0
    settle_s: Annotated[float, Meta(ge=0, le=600)] = 0.5
    homing: Annotated[
        str, Meta(pattern=r"\A(manual|\$H[XYZABCUVW]?)\Z", description="'$H' or 'manual'")
    ] = "$H"
    homing_timeout_s: Annotated[float, Meta(ge=1, le=3600)] = 180.0
    reply_timeout_s: Annotated[float, Meta(ge=0.1, le=60)] = 5.0
    connect_timeout_s: Annotated[float, Meta(ge=0.2, le=60)] = 6.0
    move_timeout_s: Annotated[float, Meta(ge=1, le=3600)] = 600.0
    poll_s: Annotated[float, Meta(ge=1e-4, le=10)] = 0.2
    shows: Shows = named(name="show", default=Shows())


class ColorimeterSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """All that a colorimeter's driver needs to know.

    Attributes:
        port: a device or a URL of pyserial.
        baud: None for the instrument's usual rate.
        spectrum: read the spectrum too, where the instrument has one.
        wavelength_std_nm: standard uncertainty of its wavelengths; 0 where none is stated.
        xyz_std: relative standard uncertainty of X, Y and Z without a spectrum, between colours;
            0 where none is stated.
    """

    driver: Text
    port: Text
    baud: Baud | None = None
    spectrum: bool = True
    reply_timeout_s: Annotated[float, Meta(ge=0.1, le=120)] = 12.0
    connect_timeout_s: Annotated[float, Meta(ge=0.2, le=120)] = 12.0
    wavelength_std_nm: Spread = 0.0
    xyz_std: Annotated[float, Meta(ge=0, le=0.5)] = 0.0


class Obstruction(Struct, frozen=True, forbid_unknown_fields=True):
    """The detector in front of the lamp: the geometries with |incidence + receiving| < `angle_deg`.

    `collides` where the two would touch: then only incidence + receiving ≥ `angle_deg` is in reach.
    Otherwise they pass each other, and only readings are refused.
    """

    angle_deg: Annotated[float, Meta(ge=0, le=90)] = 0.0
    collides: bool = False


@dataclass(frozen=True)
class Rig:
    """One goniometer, one colorimeter, and what holds between them."""

    name: str
    goniometer_settings: GoniometerSettings
    colorimeter_settings: ColorimeterSettings
    obstruction: Obstruction = field(default_factory=Obstruction)
    white: WhiteReference = WhiteReference()
    simulated: bool = False

    @property
    def stated(self) -> StatedUncertainty:
        """Its own uncertainty, as its file states it."""
        a, r, t = (self.goniometer_settings.axes[name] for name in ANGLES)
        return StatedUncertainty(
            (a.zero_std_deg, r.zero_std_deg, t.zero_std_deg),
            (a.position_std_deg, r.position_std_deg, t.position_std_deg),
            self.colorimeter_settings.wavelength_std_nm,
            self.colorimeter_settings.xyz_std,
        )

    def reachable(self, position: Position) -> str | None:
        """Why there can be no reading at `position`; None where there can."""
        hidden = self.obstruction.angle_deg
        reason = self.out_of_reach(position)
        if reason is None and abs(position.incidence_deg + position.receiving_deg) < hidden:
            reason = f"the detector hides the lamp: incidence + receiving is within {hidden:g} of 0"
        return reason

    def out_of_reach(self, position: Position) -> str | None:
        """Why the goniometer must not go to `position`; None where it may.

        The last approach counts: it starts `approach_deg` of the motor below the target.
        """
        angles = angles_of(position)
        if not np.isfinite(angles).all():
            return "its angles are not finite numbers"
        starts = angles.copy()
        for i, name in enumerate(ANGLES):
            axis = self.goniometer_settings.axes[name]
            low, high = axis.limits_deg
            if not low <= angles[i] <= high:
                return f"{name} {angles[i]:g} is outside its limits {low:g}…{high:g}"
            starts[i] -= axis.direction * self.goniometer_settings.approach_deg
            if not low <= starts[i] <= high:
                return (
                    f"{name} {angles[i]:g} is approached from {starts[i]:g}, outside its limits "
                    f"{low:g}…{high:g}"
                )
        # an axis may have to start its approach, or not: the least sum counts
        between = np.minimum(angles, starts)[:2].sum()
        if self.obstruction.collides and between < self.obstruction.angle_deg:
            return (
                "the detector would touch the lamp: incidence + receiving comes down to "
                f"{between:g}, below {self.obstruction.angle_deg:g}"
            )
        return None

    def goniometer(self, ask: Ask | None = None) -> Goniometer:
        """Open the goniometer. `ask` speaks to the operator; by default at the terminal."""
        from raden_torch.capture.spectrometer.drivers import open_goniometer

        return open_goniometer(self, ask)

    def colorimeter(self) -> Colorimeter:
        """Open the colorimeter."""
        from raden_torch.capture.spectrometer.drivers import open_colorimeter

        return open_colorimeter(self.colorimeter_settings)


def angles_of(position: Position) -> Floats:
    """`(3,)` in the order of `ANGLES`."""
    return np.array(position.angles_deg, np.float64)
