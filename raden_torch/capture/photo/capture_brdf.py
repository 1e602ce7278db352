"""Photographs of a sample of known shape → a measurement: what `raden capture brdf` does."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from raden_torch.capture.photo.brdf.agreement import Agreement, agreement
from raden_torch.capture.photo.brdf.capture_settings import CaptureSetup, SampleSpec, WhiteSpec
from raden_torch.capture.photo.brdf.cell_fit import robust_fit
from raden_torch.capture.photo.brdf.coverage import Coverage, coverage
from raden_torch.capture.photo.brdf.lamp_place import LampPlace, lamp_places
from raden_torch.capture.photo.brdf.lighting import Lamp
from raden_torch.capture.photo.brdf.movement import moved
from raden_torch.capture.photo.brdf.node_colour import NodeColour
from raden_torch.capture.photo.brdf.photo_budget import PhotoBudget, budget_of
from raden_torch.capture.photo.brdf.photo_cells import CellGrid
from raden_torch.capture.photo.brdf.photo_passes import (
    AccumulatedCells,
    PhotoView,
    first_pass,
    photo_views,
    second_pass,
)
from raden_torch.capture.photo.brdf.photo_series import PhotoSeries, read_series
from raden_torch.capture.photo.brdf.photo_white import WhiteFactor
from raden_torch.capture.photo.brdf.placement_errors import PlacementErrors
from raden_torch.capture.photo.brdf.sample_moves import SamplesByShot
from raden_torch.capture.photo.brdf.sample_shapes import Shape
from raden_torch.capture.photo.brdf.seen_surface import (
    fixed_surface,
    normal_std_deg,
    outline_std_px,
)
from raden_torch.capture.photo.brdf.shared_errors import shared_errors
from raden_torch.capture.photo.brdf.shots import Shot, check_masks
from raden_torch.capture.photo.guide.plan_check import check_planned
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import LEAST_COVERAGE
from raden_torch.measurement.systematic_errors import SystematicErrors

Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class CapturedBrdf:
    """The measurement, and how it came about.

    Attributes:
        measurement: a row a cell of the grid, at its node or (`scattered`) amid its samples; cells
            without samples are NaN and not valid.
        budget: the terms of its standard deviation.
        found: what the photographs hold, relative to the white.
        grid: the cells.
        shape: "sphere", "plane" or "cylinder".
        shots: the photographs.
        lamps: of each, in the frame of its camera.
        agreement: of the photographs with each other.
        places: where each photograph itself puts its lamp.
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
    places: LampPlace
    coverage: Coverage
    notes: tuple[str, ...]

    @property
    def read(self) -> BrdfMeasurement:
        """The cells that have samples; at incidence 0 one of each two that hold the same."""
        _, r, t = self.grid.nodes_deg().T
        at_0 = self.grid.nodes_deg()[:, 0] == 0
        again = at_0 & ((r < 0) | ((r == 0) & (t < 0)))
        return self.measurement.select(self.measurement.valid & ~again)

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
    scattered: bool = False,
    plan: Path | None = None,
    go_on: bool = False,
    progress: Progress | None = None,
) -> CapturedBrdf:
    """Read the photographs of a series and put every lit pixel on the grid.

    Args:
        grid: None: steps of 5 up to 70 degrees, or, scattered, up to 80.
        scattered: each cell's value is that amid its samples, at their own angles; as of a flat
            piece, which shows little of each cell.
        plan: of `raden capture guide`, by which the photographs were taken.
        go_on: warn instead of raising where the sample seems to have moved, or photographs
            contradict each other or their plan.
        progress: called with the share that is done, 0…1.

    Raises:
        InputError: as for what it is made of; a sample that moved, photographs that contradict each
            other beyond their uncertainty, or, not scattered, a coverage below 5 %. The message
            names the file.
    """
    grid = grid or CellGrid.reaching(scattered=scattered)
    series = read_series(photographs, setup)
    check_masks(series.shots, (sample.mask, white.mask))
    unplanned = None if plan is None else check_planned(plan, series, sample)
    warned = _raised_or_warned([unplanned], go_on=go_on)
    fixed = fixed_surface(series, sample)
    views = photo_views(series, sample, fixed)
    first = first_pass(_reported(views, series, progress, 0.0), series, white, factor, grid)
    fit = robust_fit(first.kept, grid)
    by_shot = SamplesByShot(first.kept, series, first.shapes, grid)
    outline_px = outline_std_px(fixed, setup.outline_std_px)
    places = lamp_places(by_shot, first.kept, series)
    elsewhere = places.warnings(series.names, series.lamps, normal_std_deg(fixed, outline_px))
    warned += _raised_or_warned([moved(first.edges, series.names)], go_on=go_on)

    views = photo_views(series, sample, fixed)
    half = _reported(views, series, progress, 0.5)
    found = second_pass(half, first, fit, grid, amid_samples=scattered)
    colour = NodeColour.of(setup.colour, found.scale, series.colour)
    placement = PlacementErrors.of(sample, outline_px)
    shared = shared_errors(by_shot, found, series, colour, grid, placement)
    agreed = agreement(first.kept, fit, first.scale, shared.of_samples)
    contradiction = agreed.contradiction(series.names)
    warned += [*_raised_or_warned([contradiction], go_on=go_on), *_warned(elsewhere)]
    least = 0.0 if scattered else LEAST_COVERAGE
    cover = _checked_coverage(found, grid, series, sample, first.shapes[0], least)
    budget = budget_of(found, colour, shared, scale_std=factor.relative_std)
    about = _metadata(metadata or Metadata(), sample, found, cover, factor)
    return CapturedBrdf(
        measurement=_measurement(found, grid, colour, budget, about),
        budget=budget,
        found=found,
        grid=grid,
        shape=sample.shape,
        shots=series.shots,
        lamps=series.lamps,
        agreement=agreed,
        places=places,
        coverage=cover,
        notes=(*found.scale.notes, *warned, *_said_of_colour(setup, series)),
    )


def _said_of_colour(setup: CaptureSetup, series: PhotoSeries) -> list[str]:
    if setup.colour is not None or series.colour is None:
        return []
    return [
        f"colours by {series.colour.source}, whose errors are in no uncertainty; a colour file of "
        "`raden capture colour` measures them"
    ]


def _reported(
    views: Iterator[PhotoView], series: PhotoSeries, progress: Progress | None, start: float
) -> Iterator[PhotoView]:
    """The same, with half of the whole work reported as it is done."""
    for view in views:
        yield view
        if progress is not None:
            progress(start + 0.5 * (view.number + 1) / len(series.shots))


def _raised_or_warned(doubts: Sequence[str | None], *, go_on: bool) -> list[str]:
    """The doubts there are: the first is an error, or with `go_on` all are warnings and notes."""
    there = [doubt for doubt in doubts if doubt is not None]
    for doubt in there:
        if not go_on:
            raise InputError(f"{doubt} (or continue anyway: `go_on`)")
        warnings.warn(doubt, stacklevel=3)
    return there


def _warned(lines: Sequence[str]) -> Sequence[str]:
    """The same, each a warning."""
    for line in lines:
        warnings.warn(line, stacklevel=3)
    return lines


def _metadata(
    given: Metadata,
    sample: SampleSpec,
    found: AccumulatedCells,
    cover: Coverage,
    white: WhiteFactor,
) -> Metadata:
    said = given.instrument or "camera"
    return replace(
        given,
        systematic=SystematicErrors(scale_std=white.relative_std, scale_reference=white.name),
        other=(*given.other, *_said_of(cover)),
        instrument=f"{said}; photographs of a {sample.shape} under {len(found.shots)} lamps",
    )


def _measurement(
    found: AccumulatedCells,
    grid: CellGrid,
    colour: NodeColour,
    budget: PhotoBudget,
    metadata: Metadata,
) -> BrdfMeasurement:
    angles = grid.nodes_deg() + grid.step_deg * found.nodes.at
    # below incidence 0 a geometry has another name
    incidence, receiving, tilt = np.where(angles[:, :1] < 0, -angles, angles).T
    values = colour.factors(found.nodes.value)
    return BrdfMeasurement(
        incidence,
        receiving,
        tilt,
        values=values,
        channels=colour.channels,
        std=budget.total,
        count=found.nodes.count,
        valid=np.asarray(np.isfinite(values).all(axis=1)),
        metadata=metadata,
    )


def _checked_coverage(
    found: AccumulatedCells,
    grid: CellGrid,
    series: PhotoSeries,
    sample: SampleSpec,
    shape: Shape,
    least: float,
) -> Coverage:
    """Of the grid, with a suggestion from where the first photograph was taken.

    Args:
        shape: of the sample, in the frame of the first photograph's camera.
        least: share of the grid.

    Raises:
        InputError: too little for a measurement.
    """
    lamp = series.lamps[0]
    distance = None
    if lamp.position is not None:
        distance = float(np.linalg.norm(lamp.position - shape.middle))
    covered = np.asarray(np.isfinite(found.nodes.value).all(axis=1))
    pose = series.shots[0].pose if sample.lies_on_board else None
    cover = coverage(covered, grid, shape, series.camera, pose, distance)
    if cover.share < least:
        raise InputError(_too_little(cover, series))
    return cover


def _too_little(cover: Coverage, series: PhotoSeries) -> str:
    advice = "; ".join(f"{s.text} ({s.gain} more cells)" for s in cover.next[:3]) or (
        "nothing near these lamps; another shape or camera"
    )
    files = [file for shot in series.shots for file in shot.files]
    return (
        f"{files[0]} … {files[-1].name}: expected readings in at least "
        f"{100 * LEAST_COVERAGE:g} % of the grid, got {100 * cover.share:.1f} %. What would help "
        f"most: {advice}"
    )


def _said_of(cover: Coverage) -> tuple[tuple[str, str], ...]:
    """Header entries that a fit of too little can point to."""
    return (
        ("coverage", f"{100 * cover.share:.1f} %"),
        *(("next", f"{s.text}: {s.gain} more cells") for s in cover.next[:1]),
    )
