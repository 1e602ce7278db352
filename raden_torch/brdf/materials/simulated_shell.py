"""A simulated shell as a material, without a measurement and a fit: film optics baked to be read.

`fit(simulate_specimen(name))` takes a minute and shows what a measurement leaves of a shell; this
takes a second, and is the simulation itself at every angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.materials.runtime import RuntimeBrdf, runtime_brdf
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.colorimetry import XYZ_TO_SRGB
from raden_torch.errors import InputError
from raden_torch.optics.shell_colour import ShellColour
from raden_torch.optics.specimens import SPECIMENS, TABLET_SCALES

_LAYOUT = RuntimeLayout((32, 57, 65), (0.4, 0.3))


@dataclass(frozen=True)
class SimulatedShell:
    """A shell of `optics.SPECIMENS`: a plausible nacre, not a measured one.

    The mirror image in the coat above it is left out, as in `simulate_specimen`.

    Attributes:
        name: of the specimen.
        tablet_scale: thickness of its tablets over the specimen's own, 0.7…1.4.

    Examples:
        >>> import torch
        >>> up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
        >>> f = SimulatedShell("akoya").of_unit_vectors(up, up, up)
        >>> bool((f > 0).all())
        True
    """

    name: str
    tablet_scale: float = 1.0

    def __post_init__(self) -> None:
        if self.name not in SPECIMENS:
            raise InputError(f"shell: expected one of {', '.join(SPECIMENS)}, got {self.name!r}")
        low, high = TABLET_SCALES
        if not low <= self.tablet_scale <= high:
            raise InputError(f"tablet_scale: expected {low}…{high}, got {self.tablet_scale}")

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        return geometry.working_dtype(*maps)

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """`[B, 3, H, W]` f_r in 1/sr of unit (or zero) vectors; 0 below the horizon."""
        return self.runtime_brdf().of_unit_vectors(n, l, v)

    def runtime_brdf(self) -> RuntimeBrdf:
        """The table that is read."""
        return _baked(self.name, self.tablet_scale)

    def formula(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """f_r by film optics, where n is +z and light and view lie as in `vectors_from_angles`."""
        light, view = (w.expand(n.shape)[0].flatten(1).T.double().cpu().numpy() for w in (l, v))
        xyz = ShellColour.of(self.name, self.tablet_scale).xyz_per_sr(light, view)
        rgb = torch.from_numpy(np.ascontiguousarray((xyz @ XYZ_TO_SRGB.T).T))
        return rgb.to(n).reshape(1, 3, *n.shape[-2:])

    def state(self) -> Any:
        return self.name, self.tablet_scale


@lru_cache(maxsize=64)
@torch.inference_mode(False)
@torch.no_grad()
def _baked(name: str, tablet_scale: float) -> RuntimeBrdf:
    shell = SimulatedShell(name, tablet_scale)
    return runtime_brdf(shell.formula, torch.zeros((), device="cpu"), _LAYOUT)
