"""The light that leaves the simulated stage: sample or white, lamp, and all simulated errors.

The same for the processes behind ptys and for a scan within one process. Angles err twice: by zeros
that are off by one amount each as long as the rig runs, and by where each move ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.ports import Target
from raden_torch.capture.spectrometer.simulation.simulated_radiance import Scene

_MOVED_DEG = 1e-6


@dataclass(frozen=True, slots=True)
class InstrumentErrors:
    """Simulated imperfections: standard deviations, or relative to the perfect diffuser's light.

    Attributes:
        noise: of a reading, relative to it.
        dark_noise, dark_level: of a reading of nothing, and what is left with the lamp shut.
        lamp_drift: how far, relative, the lamp wanders over hours.
        zero_deg, position_deg: of each axis' zero, and of the end of each move.
    """

    noise: float
    dark_noise: float
    dark_level: float
    lamp_drift: float
    zero_deg: float = 0.0
    position_deg: float = 0.0


class Laboratory:
    """Args:
    white_factor: the white reference's reflectance factor, the same in every geometry.
    random: of all errors; one generator, so that a seed makes one laboratory.
    """

    def __init__(
        self,
        scene: Scene,
        errors: InstrumentErrors,
        white_factor: float,
        random: np.random.Generator,
    ) -> None:
        self._scene, self._errors, self._random = scene, errors, random
        self._white = np.full(len(scene.lamp), white_factor / 100.0)
        self._sample = RegularGridInterpolator(scene.axes_deg, scene.xyz)
        self._bounds = np.array([[axis[0], axis[-1]] for axis in scene.axes_deg]).T
        self._phase = random.uniform(0, 2 * np.pi)
        self._zeros = errors.zero_deg * random.standard_normal(3)
        self._moved = np.zeros(3)
        self._last = np.full(3, np.nan)

    def radiance(self, angles_deg: Floats, target: Target, now_s: float) -> Floats:
        """`(401,)` in W/(sr·m²·nm); the angles are where the rig believes to stand."""
        angles = self._true(angles_deg)
        scene, errors = self._scene, self._errors
        if target is Target.WHITE:
            reflectance = self._white
        else:
            xyz = self._sample(np.clip(angles, *self._bounds))[0]
            reflectance = scene.reflectance_of_xyz @ xyz
        cosine = math.cos(math.radians(angles[0])) * math.cos(math.radians(angles[2]))
        level = 0.0 if target is Target.DARK else max(cosine, 0.0) * self._lamp(now_s)
        noise = 1.0 + errors.noise * self._random.standard_normal()
        dark = errors.dark_level + errors.dark_noise * self._random.standard_normal()
        return scene.lamp * (reflectance * level * noise + dark)

    def _true(self, angles_deg: Floats) -> Floats:
        """Where it stands: the error of a move stays until the next one."""
        if not (abs(angles_deg - self._last) < _MOVED_DEG).all():
            self._last = np.array(angles_deg, np.float64)
            if self._errors.position_deg:
                self._moved = self._errors.position_deg * self._random.standard_normal(3)
        return angles_deg + self._zeros + self._moved

    def _lamp(self, now_s: float) -> float:
        """It settles exponentially over an hour, and wanders over six."""
        hours = now_s / 3600.0
        settling = 1.0 - math.exp(-hours)
        wander = math.sin(2 * math.pi * hours / 6.0 + self._phase) - math.sin(self._phase)
        return 1.0 + self._errors.lamp_drift * (0.7 * settling + 0.15 * wander)
