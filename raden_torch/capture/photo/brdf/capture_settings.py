"""What a person says of a series of photographs for `raden capture brdf`: files, sample, white.

Each class is one subject. Lengths on the board are in metres in its frame, lengths of the sample
and places before the camera in mm with a camera file and in pixels without one, angles in degrees;
standard deviations are k = 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.development import Development
from raden_torch.errors import InputError

AXIS_STD_MM = 0.2
"""Of where a rod lies on the board, laid along its lines by eye."""
RADIUS_STD_MM = 0.05
"""Of a radius by a caliper."""


@dataclass(frozen=True, eq=False)
class CaptureSetup:
    """The files of the earlier steps, and how the photographs were taken.

    Attributes:
        lights: a lights file, as `raden capture lights` writes it.
        camera: a camera file, with the board's poses where they are needed; None: the camera is
            far away.
        colour: a colour file; None: camera RGB.
        lamps: of each photograph its lamp's number, from 1 to the number of lamps in `lights`;
            empty: photograph k has lamp k.
        stack: files a photograph, 1 or more: exposures of one view, one after another.
        seen_in: name of the photograph in whose camera's frame `lights` is, where the lamps stand
            beside the board and the camera moves; None where they stand beside the camera.
        lamp_std_deg: standard deviation of the lamps' directions, degrees, in each of two
            directions across; None: as the lights file has it, else `lighting.LAMP_STD_DEG`.
        outline_std_px: standard deviation of the outline that a sphere or a cylinder was found by,
            pixels; None: as its edge tells.
        development: how photographs are read.
    """

    lights: Path
    camera: Path | None = None
    colour: Path | None = None
    lamps: tuple[int, ...] = ()
    stack: int = 1
    seen_in: str | None = None
    lamp_std_deg: float | None = None
    outline_std_px: float | None = None
    development: Development = field(default_factory=Development)


@dataclass(frozen=True, eq=False)
class SampleSpec:
    """The sample's shape and where it is.

    Attributes:
        shape: "sphere", "plane" (on the board) or "cylinder".
        mask: white on it; for all photographs, so only where nothing moves. Without one a sphere is
            looked for; a cylinder needs one, a plane needs one or `region_m`.
        region_m: the corners of a plane on the board, metres: `[n, 2]`, n ≥ 3, or `[n, 3]` with
            their heights over it; or several such, of flat pieces that each have their own plane,
            as cards on wedges.
        radius_mm: of a sphere or cylinder, mm, above 0; needed with a camera.
        axis_m: `[2, 2]` two points on the board, metres, above which a cylinder's axis runs, lying
            on it; None: the axis is found from the mask's straight edges.
        axis_std_mm: standard deviation of each of these points across the axis, mm, 0 or more.
        radius_std_mm: of `radius_mm`, mm, 0 or more.
    """

    shape: Literal["sphere", "plane", "cylinder"] | str
    mask: Path | None = None
    region_m: Floats | tuple[Floats, ...] | None = None
    radius_mm: float | None = None
    axis_m: Floats | None = None
    axis_std_mm: float = AXIS_STD_MM
    radius_std_mm: float = RADIUS_STD_MM

    def __post_init__(self) -> None:
        if self.shape not in ("sphere", "plane", "cylinder"):
            raise InputError(f"shape: expected sphere, plane or cylinder, got {self.shape!r}")
        if self.shape == "plane" and self.region_m is None and self.mask is None:
            raise InputError("plane: expected its corners on the board, or a mask, got neither")
        if self.shape == "cylinder" and self.mask is None:
            raise InputError("cylinder: expected a mask that is white on it, got none")
        if self.radius_mm is not None and not 0 < self.radius_mm < np.inf:
            raise InputError(f"{self.shape}: radius: expected above 0 mm, got {self.radius_mm} mm")
        for what, std in (("axis", self.axis_std_mm), ("radius", self.radius_std_mm)):
            if not 0 <= std < np.inf:
                raise InputError(
                    f"{self.shape}: standard deviation of the {what}: expected 0 mm or more, got "
                    f"{std} mm"
                )

    @property
    def regions_m(self) -> tuple[Floats, ...]:
        """Each region; none where there is a mask alone."""
        if self.region_m is None:
            return ()
        return self.region_m if isinstance(self.region_m, tuple) else (self.region_m,)

    @property
    def lies_on_board(self) -> bool:
        """It is found by the board's pose, in each photograph anew; else it stands still."""
        return self.shape == "plane" or self.axis_m is not None


@dataclass(frozen=True, eq=False)
class WhiteSpec:
    """Where the white reference is: one of `mask`, `region_m` and `patch_px`, and its plane.

    Attributes:
        mask: white on it; where nothing moves.
        region_m: `[n, 2]`, n ≥ 3, its corners on the board, metres.
        patch_px: `[n, 2]`, n ≥ 3, its corners in the photographs, pixels, such as a chart's white
            patch (`chart_white`).
        normal: `[3]` in the camera's frame (x right, y up, z to the viewer), of any length but 0;
            None: the board's, or, without a pose, to the camera.
        at: `[3]` a point of its plane in the same frame, mm or pixels; None: on the board, or,
            without a pose, the sample's middle.
    """

    mask: Path | None = None
    region_m: Floats | None = None
    patch_px: Floats | None = None
    normal: Floats | None = None
    at: Floats | None = None

    def __post_init__(self) -> None:
        given = [place is not None for place in (self.mask, self.region_m, self.patch_px)]
        if sum(given) != 1:
            raise InputError(
                "white reference: expected one place (a mask, its corners on the board, or the "
                f"colour chart's white patch), got {sum(given)}"
            )
        if self.normal is not None and not np.linalg.norm(self.normal) > 0:
            raise InputError("white reference: normal: expected a direction, got 0")


@dataclass(frozen=True)
class WhiteFactorSpec:
    """How much the white reference reflects: `factor` or `file`, or neither for a chart's patch.

    Attributes:
        factor: reflectance factor, 100 for the perfect diffuser: "Y" or "X,Y,Z", each above 0 and
            at most 300.
        file: a measurement of the white (.csv), looked up at the white's own geometry.
        std_percent: standard uncertainty of the factor, per cent, 0…100.
        name: of the reference, as its certificate has it: measurements that name the same share its
            error.
    """

    factor: str | None = None
    file: Path | None = None
    std_percent: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.std_percent < 100:
            raise InputError(
                f"white: standard uncertainty: expected 0…100 %, got {self.std_percent} %"
            )
        if self.factor is not None and self.file is not None:
            raise InputError("white: expected a factor or a file, got both")
