"""What a scan's journal holds, and each of its lines as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec import Struct, to_builtins

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.plan_json import plan_from_json
from raden_torch.capture.spectrometer.ports import ColorReading, Position, Range, Target
from raden_torch.capture.spectrometer.scan_plan import Decision, Plan, Step, TakenReading
from raden_torch.capture.spectrometer.stated_uncertainty import StatedUncertainty
from raden_torch.capture.spectrometer.white_reference import White
from raden_torch.errors import InputError
from raden_torch.schema import Count, Finite, Positive, Triple, checked

FORMAT = 1


class _Said(Struct, frozen=True, kw_only=True):
    white: White
    reference_every_s: Finite
    reference_readings: Count
    goniometer: str
    colorimeter: str
    simulated: bool
    sample: str
    started: str
    stated: StatedUncertainty = StatedUncertainty()


class Header(_Said, frozen=True):
    """What a journal says once, at its beginning.

    Attributes:
        plan: what is read, in which order.
        white: the white reference, and where it is read.
        reference_every_s: dark and white are read again after so many seconds.
        reference_readings: how many readings of each.
        goniometer, colorimeter: what the instruments said they are.
        simulated: True where the instruments are simulated.
        sample: the specimen's name.
        started: date and time in UTC.
        stated: what the rig states of its own uncertainty; nothing in the journals of old.
    """

    plan: Plan

    def as_json(self) -> dict[str, Any]:
        return {
            "record": "header",
            "format": FORMAT,
            "plan_hash": self.plan.hash,
            "plan": self.plan.as_json(),
            **{name: _plain(getattr(self, name)) for name in _Said.__struct_fields__},
        }


@dataclass(frozen=True, slots=True)
class Reference:
    """One dark or white reading; those taken one after another have the same `series`."""

    series: int
    target: Target
    reading: ColorReading
    time_s: float


class Fault(Struct, frozen=True, tag_field="record", tag="fault"):
    """What an instrument did wrong, and how often the same reading had been tried by then."""

    kind: str
    text: str
    attempt: Count
    time_s: Finite


class Session(Struct, frozen=True, tag_field="record", tag="session"):
    """Where a run began or ended."""

    what: str
    text: str
    time_s: Finite


Record = TakenReading | Decision | Reference | Fault | Session


class _Light(Struct, kw_only=True, omit_defaults=True, tag_field="record"):
    """What an instrument answered; `nm` is first and last where wavelengths are evenly spaced."""

    time_s: Finite
    range: Range
    xyz: Triple | None
    integration_s: Finite | None
    nm: tuple[Positive, ...] | None = None
    radiance: tuple[Finite, ...] | None = None


class _ReadingLine(_Light, tag="reading"):
    number: Count
    cell: Count
    target: Target
    angles_deg: Position


class _ReferenceLine(_Light, tag="reference"):
    series: Count
    target: Target


class _DecisionLine(Struct, tag_field="record", tag="decision"):
    after: Count
    cells: tuple[Triple, ...]
    why: str
    estimated_rms: Finite
    estimated_log_error: Finite


_LINES: dict[str, type[Struct]] = {
    "reading": _ReadingLine,
    "decision": _DecisionLine,
    "reference": _ReferenceLine,
    "fault": Fault,
    "session": Session,
}


def header_from_json(data: dict[str, Any]) -> Header:
    """What `Header.as_json` wrote.

    Raises:
        InputError: another record, of another format, or a plan that was changed.
    """
    if data.get("record") != "header":
        raise InputError("not the header of a scan's journal")
    if data.get("format") != FORMAT:
        raise InputError(f"journal format: expected {FORMAT}, got {data.get('format')!r:.80}")
    said = checked(data, _Said, "")
    plan = plan_from_json(data.get("plan"))
    if plan.hash != data.get("plan_hash"):
        raise InputError("the plan is not the one that its hash was made of; it was changed")
    return Header(plan=plan, **{name: getattr(said, name) for name in said.__struct_fields__})


def record_as_json(record: Record, taken: int) -> dict[str, Any]:
    """The line of a record; `taken` readings of the plan stand before it."""
    line: Struct
    if isinstance(record, TakenReading):
        step = record.step
        line = _ReadingLine(taken, step.cell, step.target, step.position, **_light(record))
    elif isinstance(record, Reference):
        line = _ReferenceLine(record.series, record.target, **_light(record))
    elif isinstance(record, Decision):
        cells = tuple(map(tuple, record.cells.tolist()))
        line = _DecisionLine(record.after, cells, record.why, record.rms, record.log_error)
    else:
        line = record
    return _plain(line)


def record_from_json(data: dict[str, Any], taken: int) -> Record:
    """What `record_as_json` wrote.

    Raises:
        InputError: another record, or a reading with another number than `taken`.
    """
    kind = data.get("record")
    if not isinstance(kind, str) or kind not in _LINES:
        raise InputError(f"record {kind!r:.80} is not known")
    line = checked(data, _LINES[kind], "")
    if isinstance(line, _ReadingLine):
        if line.number != taken:
            raise InputError(
                f"reading {line.number} where {taken} was to follow; one is missing or there twice"
            )
        step = Step(line.cell, line.angles_deg, line.target)
        return TakenReading(step, _reading(line), line.time_s)
    if isinstance(line, _ReferenceLine):
        return Reference(line.series, line.target, _reading(line), line.time_s)
    if isinstance(line, _DecisionLine):
        cells = np.array(line.cells, np.float64).reshape(-1, 3)
        return Decision(line.after, cells, line.why, line.estimated_rms, line.estimated_log_error)
    assert isinstance(line, Fault | Session)
    return line


def _plain(value: Any) -> Any:
    return to_builtins(value, enc_hook=np.generic.item)  # a number of NumPy's, too


def _light(record: TakenReading | Reference) -> dict[str, Any]:
    reading = record.reading
    nm = radiance = None
    if reading.radiance is not None and reading.wavelengths_nm is not None:
        nm = _compact(reading.wavelengths_nm.tolist())
        radiance = reading.radiance.tolist()
    return {
        "time_s": record.time_s,
        "range": reading.range,
        "xyz": reading.xyz.tolist() if reading.range is Range.OK else None,
        "integration_s": reading.integration_s,
        "nm": nm,
        "radiance": radiance,
    }


def _reading(line: _Light) -> ColorReading:
    wavelengths = radiance = None
    if line.radiance is not None:
        radiance = np.array(line.radiance)
        wavelengths = _expanded(line.nm or (), len(radiance))
    xyz = np.array([math.nan] * 3 if line.xyz is None else line.xyz)
    return ColorReading(xyz, line.range, line.integration_s, wavelengths, radiance)


def _compact(wavelengths: list[float]) -> list[float]:
    """First and last where they are evenly spaced: a spectrum has some 400 of them."""
    even = np.linspace(wavelengths[0], wavelengths[-1], len(wavelengths))
    return [wavelengths[0], wavelengths[-1]] if np.array_equal(even, wavelengths) else wavelengths


def _expanded(nm: Sequence[float], count: int) -> Floats:
    if len(nm) == 2 and count != 2:
        return np.linspace(nm[0], nm[1], count)
    if len(nm) != count:
        raise InputError(f"nm: expected {count} wavelengths, or first and last, got {len(nm)}")
    return np.array(nm)
