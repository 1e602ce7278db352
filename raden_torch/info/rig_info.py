"""What a goniospectrometer's files hold, in words: its rig, its journals, its lists of cells."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

_ANGLES = {"incidence_deg", "receiving_deg", "tilt_deg"}


def recognises_journal(head: bytes) -> bool:
    return re.match(rb'\s*\{\s*"record"\s*:', head) is not None


def describe_journal(path: Path) -> str:
    """How far the scan came, with what, when, and whether it can go on."""
    from raden_torch.capture.spectrometer.journal import read_journal

    contents = read_journal(path)
    header, taken = contents.header, contents.taken
    kind = "simulated instruments" if header.simulated else "real instruments"
    records = (taken, contents.references, contents.faults, contents.sessions)
    times = [record.time_s for kept in records for record in kept]
    sessions = sum(session.what in ("started", "resumed") for session in contents.sessions)
    lines = [
        f"journal of a scan of {header.sample or 'an unnamed sample'} ({kind}), "
        "written by `raden scan`",
        f"goniometer: {header.goniometer}",
        f"colorimeter: {header.colorimeter}",
        f"plan: {contents.plan.name}, {len(contents.plan.cells)} cells",
        f"readings: {len(taken)} of {contents.plan.steps}; dark and white: "
        f"{len(contents.references)}; faults: {len(contents.faults)}; sessions: {sessions}",
        f"begun {header.started}; last record {_utc(max(times)) if times else 'none'}",
    ]
    if contents.torn_bytes:
        lines.append(f"its last line is cut ({contents.torn_bytes} bytes); resuming takes it off")
    if contents.finished:
        lines.append("finished")
    else:
        lines.append("not finished: `raden scan … --resume` goes on with it")
    return "\n".join(lines)


def _utc(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def recognises_rig(head: bytes) -> bool:
    return re.search(rb"^\s*\[(goniometer|colorimeter)\b", head, re.MULTILINE) is not None


def describe_rig(path: Path) -> str:
    """Instruments, axes and their limits, obstruction, white reference."""
    from msgspec.structs import asdict

    from raden_torch.capture.spectrometer.rig_config import load_rig

    rig = load_rig(path)
    stage, meter, white = rig.goniometer_settings, rig.colorimeter_settings, rig.white
    at = white.geometry
    factor = f"measured in {white.file}" if white.file else f"reflectance factor {white.factor:g}"
    lines = [
        f"rig {rig.name}{' (simulated)' if rig.simulated else ''}, for `raden scan --config`",
        f"goniometer: {stage.driver} at {stage.port}",
        *(
            f"{name}: axis {axis.letter}, {axis.limits_deg[0]:g}…{axis.limits_deg[1]:g} deg, "
            f"zero at {axis.zero_deg:g} deg, direction {axis.direction:+d}"
            for name, axis in asdict(stage.axes).items()
        ),
        f"colorimeter: {meter.driver} at {meter.port}{', with spectrum' if meter.spectrum else ''}",
        f"white reference: {white.name}, {factor}, read at incidence {at.incidence_deg:g}, "
        f"receiving {at.receiving_deg:g}, tilt {at.tilt_deg:g} deg",
    ]
    if rig.obstruction.angle_deg:
        what = "would touch" if rig.obstruction.collides else "hides"
        lines.append(f"the detector {what} the lamp within {rig.obstruction.angle_deg:g} deg of it")
    return "\n".join(lines)


def recognises_cells(head: bytes) -> bool:
    """A table of the three angles and nothing else."""
    if b"\0" in head:
        return False
    lines = head.decode("utf-8", "replace").lstrip("\ufeff").splitlines()
    first = next((line for line in lines if line.strip() and line.lstrip()[0] != "#"), "")
    return {name.strip() for name in first.split(",")} == _ANGLES


def describe_cells(path: Path) -> str:
    """How many, and their range."""
    from raden_torch.capture.spectrometer.scan_cells import list_cells

    cells = list_cells(path)
    ranges = zip(("incidence", "receiving", "tilt"), cells.min(0), cells.max(0), strict=True)
    return "\n".join(
        [
            f"list of {len(cells)} cells, for `raden scan --plan`",
            *(f"{name}: {low:g}…{high:g} deg" for name, low, high in ranges),
        ]
    )
