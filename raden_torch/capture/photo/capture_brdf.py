"""Photographs of a sample of known shape → a measurement: what `raden capture brdf` does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.photo.brdf.accumulate import Accumulated, accumulate
from raden_torch.capture.photo.brdf.budget import PhotoBudget
from raden_torch.capture.photo.brdf.cells import CellGrid
from raden_torch.capture.photo.brdf.lighting import Lamp, lamps_of_shots
from raden_torch.capture.photo.brdf.node_colour import NodeColour, budget_of
from raden_torch.capture.photo.brdf.rays import rays_through
from raden_torch.capture.photo.brdf.reference_place import WhiteSpec, white_place
from raden_torch.capture.photo.brdf.sample import SampleSpec, place
from raden_torch.capture.photo.brdf.samples import SeenSurface, see
from raden_torch.capture.photo.brdf.series import Frame, Shot, read_shot, series
from raden_torch.capture.photo.brdf.white import WhiteFactor, WhiteReading, read_white
from raden_torch.capture.photo.camera import Camera, Pose, read_camera, read_poses
from raden_torch.capture.photo.development import Development
from raden_torch.capture.photo.lamps import Lamps, read_lamps
from raden_torch.capture.photo.result_file import read_result
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata

Progress = Callable[[float], None]


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
        shots: the photographs.
        lamps: of each, in the frame of its camera.
    """

    measurement: BrdfMeasurement
    budget: PhotoBudget
    found: Accumulated
    grid: CellGrid
    shots: list[Shot]
    lamps: list[Lamp]


def capture_brdf(
    photographs: Sequence[Path],
    setup: Setup,
    sample: SampleSpec,
    white: WhiteSpec,
    factor: WhiteFactor,
    *,
    grid: CellGrid | None = None,
    metadata: Metadata | None = None,
    progress: Progress | None = None,
) -> CapturedBrdf:
    """Read the photographs of a series and put every lit pixel on the grid.

    Raises:
        InputError: as for what it is made of; the message names the file.
    """
    grid = grid or CellGrid()
    scene = _Scene.of(photographs, setup, sample)

    def white_in(k: int, frame: Frame) -> WhiteReading | None:
        shot, middle = scene.shots[k], scene.see(k).middle
        there = white_place(white, scene.camera, shot.pose, scene.size, middle, shot.name)
        rays = rays_through(scene.camera, there.x_px, there.y_px)
        return read_white(frame, there, rays, scene.lamps[k], middle, factor)

    found = accumulate(
        scene.shots, scene.lamps, scene.see, scene.read, white_in, grid, progress=progress
    )
    colour = NodeColour.of(setup.colour, found.scale)
    std = np.array([lamp.std_deg for lamp in scene.lamps])
    budget = budget_of(found, grid, colour, std, factor.relative_std)
    measurement = _measurement(found, grid, colour, budget, metadata or Metadata(), sample.shape)
    return CapturedBrdf(measurement, budget, found, grid, scene.shots, scene.lamps)


@dataclass(eq=False)
class _Scene:
    """The shots, the camera, the lamps, and the sample as the last shot asked for saw it."""

    shots: list[Shot]
    camera: Camera | None
    lamps: list[Lamp]
    sample: SampleSpec
    exponent: float
    size: tuple[int, int]
    _last: tuple[Pose | None, SeenSurface] | None = None

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
        shot = self.shots[k]
        if self._last is None or (self._moves and self._last[0] is not shot.pose):
            placed = place(
                self.sample, self.camera, shot.pose, self.size, self._pictures, shot.name
            )
            self._last = shot.pose, see(placed, self.camera)
        return self._last[1]

    @property
    def _moves(self) -> bool:
        """The sample is found by the board's pose."""
        return self.sample.shape == "plane" or self.sample.axis_m is not None

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
            metadata, instrument=f"{said}; photographs of a {shape} under {len(found.shots)} lamps"
        ),
    )
