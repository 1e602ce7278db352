"""Photographs of a sample of known shape → a measurement: what `raden capture brdf` does."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from raden_torch.capture.photo.brdf.accumulate import AccumulatedCells, accumulate
from raden_torch.capture.photo.brdf.agreement import Agreement, agreement
from raden_torch.capture.photo.brdf.cell_fit import RobustFit
from raden_torch.capture.photo.brdf.coverage import Coverage, coverage
from raden_torch.capture.photo.brdf.lighting import Lamp
from raden_torch.capture.photo.brdf.movement import Edges, edges_near, moved, outline_of
from raden_torch.capture.photo.brdf.node_colour import NodeColour, budget_of
from raden_torch.capture.photo.brdf.photo_budget import PhotoBudget
from raden_torch.capture.photo.brdf.photo_cells import CellGrid
from raden_torch.capture.photo.brdf.photo_scene import CaptureSetup, Scene
from raden_torch.capture.photo.brdf.photo_white import Scale, WhiteFactor, WhiteReading, read_white
from raden_torch.capture.photo.brdf.rays import rays_through
from raden_torch.capture.photo.brdf.reference_place import WhiteSpec, white_place
from raden_torch.capture.photo.brdf.reservoir import Reservoir
from raden_torch.capture.photo.brdf.sample import SampleSpec
from raden_torch.capture.photo.brdf.series import Frame, Shot
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import LEAST_COVERAGE
from raden_torch.measurement.systematic_errors import SystematicErrors

Progress = Callable[[float], None]
__all__ = ["CaptureSetup", "CapturedBrdf", "capture_brdf"]


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
    found: AccumulatedCells
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
    setup: CaptureSetup,
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
    scene = Scene.of(photographs, setup, sample)

    outlines: list[Edges | None] = []
    agreed: list[Agreement] = []
    names = [shot.name for shot in scene.shots]
    doubts = _Objections(go_on)

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
class _Objections:
    """Objections to the photographs: each is an error, or with `go_on` a warning and a note."""

    go_on: bool
    notes: list[str] = field(default_factory=list)

    def raise_or_note(self, doubt: str | None) -> None:
        if doubt is None:
            return
        if not self.go_on:
            raise InputError(f"{doubt} (or continue anyway: `go_on`)")
        warnings.warn(doubt, stacklevel=4)
        self.notes.append(doubt)


def _measurement(
    found: AccumulatedCells,
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
            systematic=SystematicErrors(scale_std=white.relative_std, scale_reference=white.name),
            other=(*metadata.other, *_said_of(cover)),
            instrument=f"{said}; photographs of a {shape} under {len(found.shots)} lamps",
        ),
    )


def _coverage(found: AccumulatedCells, grid: CellGrid, scene: Scene) -> Coverage:
    """Of the grid, with a suggestion from where the first photograph was taken."""
    shape, first = scene.shape_in(0), scene.lamps[0]
    distance = None
    if first.position is not None:
        distance = float(np.linalg.norm(first.position - shape.middle))
    covered = np.asarray(np.isfinite(found.nodes.value).all(axis=1))
    pose = scene.shots[0].pose if scene.moves else None
    return coverage(covered, grid, shape, scene.camera, pose, distance)


def _too_little(cover: Coverage, photographs: Sequence[Path]) -> str:
    advice = "; ".join(f"{s.text} ({s.gain} more cells)" for s in cover.next[:3]) or (
        "nothing near these lamps; another shape or camera"
    )
    return (
        f"{photographs[0]} … {photographs[-1].name}: expected readings in at least "
        f"{100 * LEAST_COVERAGE:g} % of the grid, got {100 * cover.share:.1f} %. What would help "
        f"most: {advice}"
    )


def _said_of(cover: Coverage) -> tuple[tuple[str, str], ...]:
    """Header entries that a fit of too little can point to."""
    return (
        ("coverage", f"{100 * cover.share:.1f} %"),
        *(("next", f"{s.text}: {s.gain} more cells") for s in cover.next[:1]),
    )
