"""How a file is converted, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass

from raden_torch.capture.exchange.formats import FORMATS


@dataclass(frozen=True)
class Options:
    """How a file is converted.

    Attributes:
        to: the format, a key of `FORMATS`; None: the one that the suffix means.
        channel: the one channel to keep, as "Y" or "550nm".
        average: take readings at several azimuths of the sample for one.
        assume: "isotropic" completes one plane, one view or one side of readings, as `fit` does.
        holes: leave what lies beyond the measured angles empty.
        step_deg: of a grid that is made; None: the readings' own grid, else `STEP_DEG`.
    """

    to: str | None = None
    channel: str | None = None
    average: bool = False
    assume: str | None = None
    holes: bool = False
    step_deg: float | None = None


@dataclass(frozen=True)
class Conversion:
    """What was written, and what was lost.

    Attributes:
        format: its name.
        places: directions, above the horizon, that the file has room for.
        as_read: of these, the ones that are readings.
        interpolated: the ones within the measured angles that are not.
        continued: the ones beyond them.
        empty: the ones without a value.
        lost: what the file does not hold of what there was, a phrase each.
    """

    format: str
    places: int
    as_read: int
    interpolated: int
    continued: int
    empty: int
    lost: tuple[str, ...]

    def __str__(self) -> str:
        counts = (
            (self.as_read, "as read"),
            (self.interpolated, "interpolated"),
            (self.continued, "continued beyond the measured angles"),
            (self.empty, "empty"),
        )
        parts = ", ".join(f"{number} {what}" for number, what in counts if number)
        lost = "; ".join(self.lost) or "nothing"
        return f"{FORMATS[self.format].title}: {self.places} directions, {parts}\nlost: {lost}"
