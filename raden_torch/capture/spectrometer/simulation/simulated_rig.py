"""`simulated_rig`: a measurement file becomes a rig that can be scanned."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from raden_torch.capture.spectrometer.rig import Rig
from raden_torch.capture.spectrometer.simulation.faults import Fault


@dataclass(frozen=True, slots=True)
class Conditions:
    """How good the simulated laboratory is. Relative numbers; times of the simulated clock.

    Attributes:
        noise: standard deviation of a reading, relative to it.
        dark_noise_cd_m2: standard deviation of a reading of nothing.
        dark_level_cd_m2: what is left with the lamp shut (stray light, the instrument's own zero).
        lamp_drift: how far the lamp wanders from its first level, over hours.
        white_luminance_cd_m2: of the white reference at incidence 0.
        saturation_cd_m2: above this the instrument answers ER10.
    """

    noise: float = 0.002
    dark_noise_cd_m2: float = 0.002
    dark_level_cd_m2: float = 0.05
    lamp_drift: float = 0.01
    white_luminance_cd_m2: float = 1000.0
    saturation_cd_m2: float = 5e5


@dataclass(frozen=True, slots=True)
class SimulatedRig:
    """A running simulation.

    Attributes:
        rig: to scan with, as if it were real.
        config_path: the same rig as a file for `load_rig`, for use from another process.
    """

    rig: Rig
    config_path: Path

    def faults_injected(self) -> dict[Fault, int]:
        """How many faults of each kind have happened so far."""
        raise NotImplementedError


@contextmanager
def simulated_rig(
    measurement: str | os.PathLike[str],
    *,
    seed: int = 0,
    faults: Mapping[Fault, float] | None = None,
    time_scale: float = 1.0,
    conditions: Conditions | None = None,
) -> Iterator[SimulatedRig]:
    """Run a simulated goniometer and colorimeter around the sample of a measurement file.

    Args:
        measurement: a file of `raden_torch.load_measurement`, on a grid; between its nodes it is
            interpolated linearly.
        seed: of noise and faults.
        faults: the probability of each fault at each opportunity for it (a reply, a measurement, a
            move).
        time_scale: how many simulated seconds pass in one real second.

    Yields:
        The running rig; it ends with the block, and with the process that opened it.

    Raises:
        InputError: the measurement cannot be read or is not a grid; a number is out of range.
    """
    raise NotImplementedError
    yield
