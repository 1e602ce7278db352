"""What lights all frames of a job, as plain data that travels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from raden_torch.brdf.files.environment_file import load_environment
from raden_torch.brdf.shading.light_setups import light_setup
from raden_torch.brdf.shading.lights import Light


@dataclass(frozen=True)
class Lighting:
    """Lamps, and what surrounds the scene: a lat-long map or a setup, or neither.

    Attributes:
        lamps: by themselves.
        environment: the map's file, as `load_environment` reads it.
        light_setup: instead, the name of one of `light_setups`.
        rotation_deg, intensity: of the surroundings.
    """

    lamps: tuple[Light, ...] = ()
    environment: Path | None = None
    light_setup: Literal["tent", "window", "softbox"] | None = None
    rotation_deg: float = 0.0
    intensity: float = 1.0

    def lights(self) -> list[Light]:
        """All of them."""
        return [*self.lamps, *self.surroundings()]

    def surroundings(self) -> list[Light]:
        """None, or one; the map is read."""
        turned, intensity = self.rotation_deg, self.intensity
        if self.light_setup is not None:
            setup = light_setup(self.light_setup)
            return [replace(setup, rotation_deg=turned, intensity=intensity)]
        if self.environment is None:
            return []
        return [load_environment(self.environment, rotation_deg=turned, intensity=intensity)]


UNSAID = Lighting()
"""The lights that a picture has where none are given."""
