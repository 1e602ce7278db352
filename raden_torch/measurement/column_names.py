"""Column names as people write them → the project's own.

"Incidence (deg)", "RECEIVING [°]", "tilt_deg" → incidence_deg, receiving_deg, tilt_deg;
"550 nm" → 550nm; "STD_X", "std 550 nm" → std_X, std_550nm. An angle without its unit, or in
radians, stays what it is, and so do x, y, z: they would be chromaticities.
"""

from __future__ import annotations

import re

_UNIT = r"[ _]*[(\[/]? *({}) *[)\]]?"
_ANGLE = re.compile(
    "(incidence|receiving|tilt|azimuth)(?:[ _]angle)?" + _UNIT.format("deg|degrees?|[°º˚]"), re.I
)
_BAND = re.compile(r"(\d+(?:[.,]\d+)?)" + _UNIT.format("nm"), re.I | re.ASCII)
_SPREAD = re.compile("std[ _]+(.+)", re.I)


def own_name(written: str) -> str:
    """The project's name of a column; what it does not know is returned without outer spaces."""
    name = " ".join(written.split())
    if angle := _ANGLE.fullmatch(name):
        return f"{angle[1].lower()}_deg"
    if spread := _SPREAD.fullmatch(name):
        return f"std_{_own_channel(spread[1])}"
    return name.lower() if name.lower() in ("count", "valid") else _own_channel(name)


def _own_channel(name: str) -> str:
    band = _BAND.fullmatch(name)
    return f"{band[1].replace(',', '.')}nm" if band else name
