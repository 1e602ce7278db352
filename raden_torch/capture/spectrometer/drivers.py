"""Which driver is behind a name: the four that are here, and those that other packages bring.

A package brings one by an entry point in the group `raden_torch.goniometer` or
`raden_torch.colorimeter` (see docs/rig.md).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from raden_torch.capture.spectrometer.ports import Colorimeter, Goniometer
from raden_torch.capture.spectrometer.rig import Ask, ColorimeterSettings, Rig
from raden_torch.errors import InputError

GONIOMETERS = {"grbl": "raden_torch.capture.spectrometer.grbl:GrblGoniometer"}
COLORIMETERS = {
    "cs2000": "raden_torch.capture.spectrometer.cs2000:Cs2000",
    "cr": "raden_torch.capture.spectrometer.cr_series:CrSeries",
    "cs100a": "raden_torch.capture.spectrometer.cs100a:Cs100a",
}
GONIOMETER_GROUP = "raden_torch.goniometer"
COLORIMETER_GROUP = "raden_torch.colorimeter"


def open_goniometer(rig: Rig, ask: Ask | None = None) -> Goniometer:
    """Open the goniometer of a rig: `driver(rig, ask)`."""
    return _driver(GONIOMETERS, GONIOMETER_GROUP, rig.goniometer_settings.driver)(
        rig, ask or ask_at_terminal
    )


def open_colorimeter(settings: ColorimeterSettings) -> Colorimeter:
    """Open a colorimeter: `driver(settings)`."""
    return _driver(COLORIMETERS, COLORIMETER_GROUP, settings.driver)(settings)


def known(built_in: dict[str, str], group: str) -> list[str]:
    """The names of all drivers of a kind."""
    return [*built_in, *sorted(point.name for point in entry_points(group=group))]


def ask_at_terminal(text: str) -> None:
    """Show the operator a line and wait for the Return key.

    Raises:
        InputError: nobody is there to answer.
    """
    print(f"{text} [Return] ", end="", file=sys.stderr, flush=True)
    try:
        input()
    except EOFError:
        raise InputError(f"{text!r} needs an operator; run the scan at a terminal") from None


def _driver(built_in: dict[str, str], group: str, name: str) -> Callable[..., Any]:
    if name in built_in:
        module, attribute = built_in[name].split(":")
        return getattr(import_module(module), attribute)
    for point in entry_points(group=group, name=name):
        return point.load()
    raise InputError(f"driver: expected one of {', '.join(known(built_in, group))}, got {name!r}")
