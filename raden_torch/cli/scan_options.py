"""Options of `raden scan`."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from raden_torch.capture.spectrometer.plan_choice import PlanChoice
from raden_torch.cli.option_types import Limits, Pairs, Triple, number
from raden_torch.cli.status import working
from raden_torch.errors import InputError

if TYPE_CHECKING:
    from raden_torch.capture.spectrometer.rig import Rig
    from raden_torch.capture.spectrometer.scan_session import References
    from raden_torch.capture.spectrometer.simulation import Fault

_FINE_STEP_DEG = 2.5


@Parameter(name="*", group=Group("The rig", sort_key=2))
@dataclass(frozen=True)
class RigOptions:
    """A rig, or a simulated one."""

    config: Path | None = None
    """the rig file; see docs/rig.md"""
    simulate: bool = False
    """use a simulated rig instead, over the same serial protocols"""
    specimen: str = "yakogai"
    """what the simulated rig measures: yakogai, …, or a measurement file"""
    time_scale: float = 300.0
    """how much faster than a real rig a simulated one runs"""
    fault: Pairs = ()
    """fault of the simulated rig and its probability, as busy=0.01; may be repeated"""

    def __post_init__(self) -> None:
        if self.config is not None and self.fault:
            raise InputError("--fault: only a simulated rig has faults on demand")

    def scale(self, dry_run: bool) -> float:
        """How much faster than a real rig this one runs."""
        return 1.0 if dry_run or not self.simulate else self.time_scale

    @contextmanager
    def rig(self, scale: float, seed: int) -> Iterator[Rig]:
        """The rig of a file; or a simulated one, which runs inside the block."""
        if self.config is not None:
            from raden_torch.capture.spectrometer.rig_config import load_rig

            yield load_rig(self.config)
            return
        from raden_torch.capture.spectrometer.simulation import simulated_rig
        from raden_torch.optics import SPECIMENS, simulate_specimen

        chances = self._chances()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(self.specimen)
            if self.specimen not in SPECIMENS and not path.exists():
                raise InputError(
                    f"--specimen: expected {', '.join(SPECIMENS)} or a measurement file, got "
                    f"{self.specimen}"
                )
            if self.specimen in SPECIMENS:
                path = Path(folder) / f"{self.specimen}.csv"
                with working("simulating the specimen"):
                    simulate_specimen(self.specimen, step_deg=_FINE_STEP_DEG).save(path)
            with simulated_rig(path, seed=seed, faults=chances, time_scale=scale) as simulated:
                yield simulated.rig

    def _chances(self) -> dict[Fault, float]:
        from raden_torch.capture.spectrometer.simulation import Fault

        known = {fault.value: fault for fault in Fault}
        for name, chance in self.fault:
            if name not in known:
                raise InputError(f"--fault: expected one of {', '.join(known)}, got {name}")
            try:
                number(chance)
            except ValueError as error:
                raise InputError(f"--fault: {error}") from None
        return {known[name]: number(chance) for name, chance in self.fault}


@Parameter(name="*", group=Group("The plan", sort_key=3))
@dataclass(frozen=True)
class PlanOptions(PlanChoice):
    """The library's `PlanChoice`; here is only what text does not say by itself."""

    kind: Annotated[str | None, Parameter(name="--plan")] = None
    incidence: Limits | None = None
    receiving: Limits | None = None
    tilt: Limits | None = None


@Parameter(name="*", group=Group("Dark and white readings", sort_key=4))
@dataclass(frozen=True)
class ReferenceOptions:
    """How often dark and white are read; None where nothing was said."""

    white_every: float | None = None
    """interval between dark and white readings, minutes; default 10"""
    white_readings: int | None = None
    """number of dark and of white readings each time; default 5"""

    @property
    def are_made(self) -> bool:
        """Whether anything was said."""
        return self != ReferenceOptions()

    def references(self, scale: float = 1.0) -> References:
        """On a rig that runs `scale` times as fast as a real one."""
        from raden_torch.capture.spectrometer.scan_session import References

        every_s = 600.0 if self.white_every is None else 60 * self.white_every
        return References(
            every_s / scale, 5 if self.white_readings is None else self.white_readings
        )


@Parameter(name="*")
@dataclass(frozen=True)
class SessionOptions:
    """What is done with rig and plan."""

    sample: str | None = None
    """name of the specimen"""
    stands_at: Triple | None = None
    """do not home: the rig stands at this incidence,receiving,tilt"""
    resume: bool = False
    """continue a scan from its journal"""
    queue: Path | None = None
    """take the scans that a file lists, one after another (.toml); see docs/measuring.md"""
    from_journal: Path | None = None
    """write what a journal holds so far; needs no instrument"""
    dry_run: bool = False
    """show what would be read and how long it takes"""
    reading_seconds: float = 3.0
    """time of one reading, with --dry-run only"""
    check: bool = False
    """talk to each instrument, without moving anything"""
    yes: bool = False
    """with --check: home, and read dark and white"""

    def __post_init__(self) -> None:
        if self.yes and not self.check:
            raise InputError("--yes goes with --check")

    @property
    def needs_output(self) -> bool:
        return not (self.check or self.dry_run)
