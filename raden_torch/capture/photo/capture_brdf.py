"""Photographs of a sample of known shape → a measurement: what `raden capture brdf` does."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.photo.brdf.accumulate import Accumulated, accumulate
from raden_torch.capture.photo.brdf.agreement import Agreement, agreement
from raden_torch.capture.photo.brdf.budget import PhotoBudget
from raden_torch.capture.photo.brdf.cell_fit import RobustFit
from raden_torch.capture.photo.brdf.cells import CellGrid
from raden_torch.capture.photo.brdf.coverage import Coverage, coverage
from raden_torch.capture.photo.brdf.lighting import Lamp, lamps_of_shots
from raden_torch.capture.photo.brdf.movement import Edges, edges_near, moved, outline_of
from raden_torch.capture.photo.brdf.node_colour import NodeColour, budget_of
from raden_torch.capture.photo.brdf.rays import rays_through
from raden_torch.capture.photo.brdf.reference_place import WhiteSpec, white_place
from raden_torch.capture.photo.brdf.reservoir import Reservoir
from raden_torch.capture.photo.brdf.sample import Placed, SampleSpec, place
from raden_torch.capture.photo.brdf.samples import SeenSurface, see
from raden_torch.capture.photo.brdf.series import Frame, Shot, read_shot, series
from raden_torch.capture.photo.brdf.shapes import Shape
from raden_torch.capture.photo.brdf.white import Scale, WhiteFactor, WhiteReading, read_white
from raden_torch.capture.photo.camera import Camera, Pose, read_camera, read_poses
from raden_torch.capture.photo.development import Development
from raden_torch.capture.photo.lamps import Lamps, read_lamps
from raden_torch.capture.photo.result_file import read_result
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.common_errors import CommonErrors
from raden_torch.measurement.readings import LEAST_COVERAGE

Progress = Callable[[float], None]

_OUTLINE_PX = 0.3
"""How well an outline is known where it is a mask's: its normals hang on it."""


@dataclass(frozen=True, eq=False)
class Setup:
    """The files of the earlier steps, and what a person says of the series.

    Attributes:
        lights: a lights file.
        camera: a camera file, with the board's poses where they are needed; None: far away.
        colour: a colour file; None: camera RGB.
        lamps: of each photograph its lamp's number, from 1; empty: photograph k has lamp k.
        stack: files a photograph.
        seen_in: the photograph in whose camera's frame the lights file is, where the lamps stand
            beside the board; None where they stand beside the camera.
        lamp_std_deg: standard deviation of the lamps' directions; None: see `lighting`.
        development: how photographs are read.
    """

    lights: Path
    camera: Path | None = None
    colour: Path | None = None
    lamps: tuple[int, ...] = ()
    stack: int = 1
    seen_in: str | None = None
    lamp_std_deg: float | None = None
    development: Development = field(default_factory=Development)


@dataclass(frozen=True, eq=False)
class CapturedBrdf:
    """The measurement, and how it came about.

    Attributes:
        measurement: on the whole grid; cells without samples are NaN and not valid.
        budget: the terms of its standard deviation.
        found: what the photographs hold, relative to the white.
        grid: the cells.
        shape: "sphere", "plane" or "cylinder".
        shots: the photographs.
        lamps: of each, in the frame of its camera.
        agreement: of the photographs with each other.
        coverage: of the grid, and what would help.
        notes: what a person should know.
    """

    measurement: BrdfMeasurement
    budget: PhotoBudget
    found: Accumulated
    grid: CellGrid
    shape: str
    shots: list[Shot]
    lamps: list[Lamp]
    agreement: Agreement
    coverage: Coverage
    notes: tuple[str, ...]

    def __str__(self) -> str:
        lines = [
            f"{self.found.samples} samples from {len(self.shots)} photographs; "
            f"{100 * self.found.left_out:.2f} % left out as outliers",
            str(self.coverage),
            *(f"note: {note}" for note in self.notes),
        ]
        return "\n".join(lines)


def capture_brdf(
    photographs: Sequence[Path],
    setup: Setup,
    sample: SampleSpec,
    white: WhiteSpec,
    factor: WhiteFactor,
    *,
    grid: CellGrid | None = None,
    metadata: Metadata | None = None,
    go_on: bool = False,
    progress: Progress | None = None,
) -> CapturedBrdf:
    """Read the photographs of a series and put every lit pixel on the grid.

    Args:
        go_on: warn instead of raising where the sample seems to have moved, or photographs
            contradict each other.
        progress: called with the share that is done, 0…1.

    Raises:
        InputError: as for what it is made of; a sample that moved, photographs that contradict each
            other beyond their uncertainty, or a coverage below 5 %. The message names the file.
    """
    grid = grid or CellGrid()
    scene = _Scene.of(photographs, setup, sample)

    outlines: list[Edges | None] = []
    agreed: list[Agreement] = []
    names = [shot.name for shot in scene.shots]
    doubts = _Doubts(go_on)

    def look(k: int, frame: Frame) -> WhiteReading | None:
        shot, seen = scene.shots[k], scene.see(k)
        outlines.append(edges_near(frame.radiance, outline_of(seen, scene.size)))
        there = white_place(white, scene.camera, shot.pose, scene.size, seen.middle, shot.name)
        rays = rays_through(scene.camera, there.x_px, there.y_px)
        return read_white(frame, there, rays, scene.lamps[k], seen.middle, factor)

    def check(kept: Reservoir, fit: RobustFit, scale: Scale) -> None:
        doubts.raise_or_note(moved(outlines, names))
        std = np.array([lamp.std_deg for lamp in scene.lamps])
        agreed.append(agreement(kept, fit, scale, grid, std))
        doubts.raise_or_note(agreed[0].contradiction(names))

    found = accumulate(
        scene.shots, scene.lamps, scene.see, scene.read, look, grid, progress=progress, check=check
    )
    cover = _coverage(found, grid, scene)
    if cover.share < LEAST_COVERAGE:
        raise InputError(_too_little(cover, photographs))
    colour = NodeColour.of(setup.colour, found.scale)
    budget = budget_of(
        found,
        grid,
        colour,
        lamp_std_deg=np.array([lamp.std_deg for lamp in scene.lamps]),
        normal_std_deg=scene.normal_std_deg,
        scale_std=factor.relative_std,
    )
    return CapturedBrdf(
        measurement=_measurement(
            found, grid, colour, budget, metadata or Metadata(), sample.shape, cover, factor
        ),
        budget=budget,
        found=found,
        grid=grid,
        shape=sample.shape,
        shots=scene.shots,
        lamps=scene.lamps,
        agreement=agreed[0],
        coverage=cover,
        notes=(*found.scale.notes, *doubts.notes),
    )


@dataclass(eq=False)
class _Doubts:
    """What speaks against the photographs: an error, or with `go_on` a warning and a note."""

    go_on: bool
    notes: list[str] = field(default_factory=list)

    def raise_or_note(self, doubt: str | None) -> None:
        if doubt is None:
            return
        if not self.go_on:
            raise InputError(f"{doubt} (or go on all the same: --go-on)")
        warnings.warn(doubt, stacklevel=4)
        self.notes.append(doubt)


@dataclass(eq=False)
class _Scene:
    """The shots, the camera, the lamps, and the sample as the last shot asked for saw it."""

    shots: list[Shot]
    camera: Camera | None
    lamps: list[Lamp]
    sample: SampleSpec
    exponent: float
    size: tuple[int, int]
    _last: tuple[Pose | None, Placed, SeenSurface] | None = None

    @classmethod
    def of(cls, photographs: Sequence[Path], setup: Setup, sample: SampleSpec) -> _Scene:
        lamps: Lamps = read_lamps(setup.lights)
        camera = None if setup.camera is None else read_camera(setup.camera)
        poses = _poses(setup.camera)
        shots = series(
            photographs,
            lamps,
            setup.lights,
            stack=setup.stack,
            numbers=setup.lamps,
            poses=poses,
            how=setup.development,
        )
        each = lamps_of_shots(
            lamps,
            shots,
            camera,
            setup.lights,
            seen_in=_seen_in(setup, poses),
            std_deg=setup.lamp_std_deg,
        )
        size = read_shot(shots[0]).size
        if camera is not None and camera.size != size:
            (h, w), (height, width) = camera.size, size
            raise InputError(
                f"{setup.camera}: a camera of {w} x {h} pixels, but the photographs have {width} x "
                f"{height}; the camera that took them, at the same size, was wanted"
            )
        return cls(shots, camera, each, sample, lamps.exponent, size)

    def read(self, shot: Shot) -> Frame:
        frame = read_shot(shot, self.exponent)
        if frame.size != self.size:
            (h, w), (height, width) = self.size, frame.size
            raise InputError(
                f"{shot.files[0]}: {width} x {height} pixels, but {self.shots[0].name} has {w} x "
                f"{h}; photographs of one size were wanted"
            )
        return frame

    def see(self, k: int) -> SeenSurface:
        """What the pixels of shot k see of the sample."""
        return self._placed(k)[1]

    def shape_in(self, k: int) -> Shape:
        """The sample's shape in the frame of shot k's camera."""
        return self._placed(k)[0].shape

    @property
    def moves(self) -> bool:
        """The sample is found by the board's pose."""
        return self.sample.shape == "plane" or self.sample.axis_m is not None

    @property
    def normal_std_deg(self) -> float:
        """Of the normals, where they hang on an outline: that over the radius in the picture."""
        if self.moves:
            return 0.0
        seen = self.see(0)
        across = min(np.ptp(seen.x_px), np.ptp(seen.y_px)) / 2
        return float(np.degrees(_OUTLINE_PX / max(across, 1.0)))

    def _placed(self, k: int) -> tuple[Placed, SeenSurface]:
        shot = self.shots[k]
        if self._last is None or (self.moves and self._last[0] is not shot.pose):
            placed = place(
                self.sample, self.camera, shot.pose, self.size, self._pictures, shot.name
            )
            self._last = shot.pose, placed, see(placed, self.camera)
        return self._last[1:]

    def _pictures(self) -> list[NDArray[Any]]:
        return [self.read(shot).radiance for shot in self.shots]


def _poses(path: Path | None) -> dict[str, Pose]:
    """The board's poses in a camera file; none in an OpenCV file, or one without a board."""
    if (
        path is None
        or path.suffix.lower() != ".json"
        or "poses" not in read_result(path, "camera", ())
    ):
        return {}
    return read_poses(path)[1]


def _seen_in(setup: Setup, poses: dict[str, Pose]) -> Pose | None:
    if setup.seen_in is None:
        return None
    name = Path(setup.seen_in).name
    if name not in poses:
        raise InputError(
            f"{setup.camera}: no pose of the board in {name}, in whose frame the lights are; "
            f"{', '.join(list(poses)[:4]) or 'none'} are there"
        )
    return poses[name]


def _measurement(
    found: Accumulated,
    grid: CellGrid,
    colour: NodeColour,
    budget: PhotoBudget,
    metadata: Metadata,
    shape: str,
    cover: Coverage,
    white: WhiteFactor,
) -> BrdfMeasurement:
    incidence, receiving, tilt = grid.nodes_deg().T
    values = colour.factors(found.nodes.value)
    said = metadata.instrument or "camera"
    return BrdfMeasurement(
        incidence,
        receiving,
        tilt,
        values=values,
        channels=colour.channels,
        std=budget.total,
        count=found.nodes.count,
        valid=np.asarray(np.isfinite(values).all(axis=1)),
        metadata=replace(
            metadata,
            common=CommonErrors(scale_std=white.relative_std, scale_reference=white.name),
            other=(*metadata.other, *_said_of(cover)),
            instrument=f"{said}; photographs of a {shape} under {len(found.shots)} lamps",
        ),
    )


def _coverage(found: Accumulated, grid: CellGrid, scene: _Scene) -> Coverage:
    """Of the grid, with a suggestion from where the first photograph was taken."""
    shape, first = scene.shape_in(0), scene.lamps[0]
    distance = None
    if first.position is not None:
        distance = float(np.linalg.norm(first.position - shape.middle))
    covered = np.asarray(np.isfinite(found.nodes.value).all(axis=1))
    pose = scene.shots[0].pose if scene.moves else None
    return coverage(covered, grid, shape, scene.camera, pose, distance)


def _too_little(cover: Coverage, photographs: Sequence[Path]) -> str:
    advice = "; ".join(f"{s.text} ({s.gain} more cells)" for s in cover.next[:3])
    return (
        f"{photographs[0]} … {photographs[-1].name}: they cover {100 * cover.share:.1f} % of the "
        f"grid; at least {100 * LEAST_COVERAGE:g} % were wanted. What would help most: {advice}"
    )


def _said_of(cover: Coverage) -> tuple[tuple[str, str], ...]:
    """Header entries that a fit of too little can point to."""
    return (
        ("coverage", f"{100 * cover.share:.1f} %"),
        *(("next", f"{s.text}: {s.gain} more cells") for s in cover.next[:1]),
    )
