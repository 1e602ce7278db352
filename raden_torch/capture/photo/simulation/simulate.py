"""A folder of simulated photographs and their truth: what `raden capture simulate` does."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.materials import Material, material_of, truth_of
from raden_torch.capture.photo.simulation.mitsuba_scene import printed, sheet
from raden_torch.capture.photo.simulation.photo_file import write_photograph
from raden_torch.capture.photo.simulation.photo_plan import (
    FACING,
    PLAN_NAME,
    WHITE,
    PhotoPlan,
    camera_of,
    lamp_at,
)
from raden_torch.capture.photo.simulation.plane_set import plane_plan
from raden_torch.capture.photo.simulation.planned_set import planned_set, things_beside
from raden_torch.capture.photo.simulation.renderer import SPECIMEN, Studio
from raden_torch.capture.photo.simulation.simulated_camera import View
from raden_torch.capture.photo.simulation.sphere_set import sphere_plan
from raden_torch.capture.photo.simulation.truth import commands, write_truth
from raden_torch.capture.photo.simulation.variants import SCALAR, mitsuba
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels
from raden_torch.images.pixels import write_pixels

_PEAK = 0.85
"""Of the white level: what the brightest point of the specimen and of the white is exposed to."""
_BOARD_LAMP_MM = np.array([150.0, 250.0, 60.0])


@dataclass(frozen=True)
class Options:
    """What is photographed, and how.

    Attributes:
        material: a name or a measurement file (`materials.material_of`).
        shape: "sphere" or "plane".
        lamps: how many, 3…99.
        views: places of the camera, 1…9, for a plane.
        near: lamps at 0.75 to 1.3 m instead of 200 m.
        width: of the photographs, 300…6000 pixels; the height is two thirds of it.
        bits: of the camera's converter, 8…16; 8 stores 8-bit files.
        stack: exposures a photograph, 1…5, each four times as long as the one before.
        points: rays along a pixel's edge, 1…8.
        seed: of the noise and of where things stand, 0…2³¹.
        variant: of Mitsuba.
        plan: a plan of `raden capture guide` for a flat piece: then it says how many photographs
            there are and where lamp and camera stand, and `lamps`, `views` and `near` say nothing.

    Raises:
        InputError: a number out of its range.
    """

    material: str = "yakogai"
    shape: str = "sphere"
    lamps: int = 29
    views: int = 6
    near: bool = False
    width: int = 1200
    bits: int = 14
    stack: int = 1
    points: int = 2
    seed: int = 0
    variant: str = SCALAR
    plan: Path | None = None

    def __post_init__(self) -> None:
        if self.shape not in ("sphere", "plane"):
            raise InputError(f"shape: expected sphere or plane, got {self.shape!r}")
        ranges = {
            "lamps": (3, 99),
            "views": (1, 9),
            "width": (300, 6000),
            "bits": (8, 16),
            "stack": (1, 5),
            "points": (1, 8),
            "seed": (0, 2**31),
        }
        if self.plan is not None and self.shape != "plane":
            raise InputError(
                f"{self.plan}: expected shape plane, which a plan can be simulated for, got "
                f"{self.shape}"
            )
        if self.shape == "plane" and self.stack > 1:
            raise InputError(
                f"stack: expected 1 for a plane, got {self.stack}; exposure stacks are made of a "
                "sphere"
            )
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"{name}: expected {low}…{high}, got {value}")


def simulate_photographs(
    folder: Path, options: Options, *, progress: Callable[[float], None] | None = None
) -> list[str]:
    """Photograph a simulated specimen into a folder that is new or empty.

    Args:
        progress: called with the share that is done, 0…1.

    Returns:
        The commands that make a measurement of the photographs.

    Raises:
        InputError: Mitsuba is missing, an unknown material, a folder that is not empty.
    """
    done = progress or (lambda share: None)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: expected a new folder, got one that is not empty")
    mi = mitsuba(options.variant)
    material = material_of(options.material)
    plan = _plan(mi, options)
    with _whole_folder(folder) as beside:
        taken = _PhotoSession(mi, beside, plan, material, options, done)
        taken.boards()
        taken.lamps_and_chart()
        truth_of(mi, material).save(beside / "truth.csv")
        if options.plan is not None:
            shutil.copyfile(options.plan, beside / PLAN_NAME)
        write_truth(
            beside, plan, material, taken.names, taken.seconds, options.stack, options.variant
        )
    return commands(plan, taken.names, options.stack)


@contextmanager
def _whole_folder(folder: Path) -> Iterator[Path]:
    """A folder beside it, renamed when all is in it and removed where it is not finished."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.") as beside:
        inside = Path(beside) / folder.name
        inside.mkdir()
        yield inside
        if folder.is_dir():
            folder.rmdir()  # it was empty
        inside.rename(folder)


def _plan(mi: Any, options: Options) -> PhotoPlan:
    if options.plan is not None:
        what = {"width": options.width, "bits": options.bits, "seed": options.seed}
        return planned_set(mi, options.plan, **what)
    camera = camera_of(options.width, options.bits)
    how: dict[str, Any] = {"lamps": options.lamps, "near": options.near, "seed": options.seed}
    if options.shape == "sphere":
        return sphere_plan(mi, camera, **how)
    return plane_plan(mi, camera, views=options.views, **how)


class _PhotoSession:
    """The photographs of one plan, one after another."""

    def __init__(
        self,
        mi: Any,
        folder: Path,
        plan: PhotoPlan,
        material: Material,
        options: Options,
        done: Callable[[float], None],
    ) -> None:
        self._mi, self._folder, self._plan, self._material = mi, folder, plan, material
        self._options, self._done = options, done
        self._rng = np.random.default_rng([options.seed, 2])
        self._count, self._all = 0, len(plan.boards) + len(plan.lamps) + len(plan.shots) + 1
        self.names: dict[str, list[str]] = {"board": [], "chart": [], "lamp": [], "ball": []}
        self.seconds: dict[str, float] = {}

    def boards(self) -> None:
        """The board alone, in its poses before the camera at 0."""
        plan = self._plan
        for k, place in enumerate(plan.boards):
            things = {"board": sheet(self._mi, place, printed(self._mi, plan.board.picture()))}
            studio = Studio(self._mi, things, {}, None, plan.camera, FACING, points=3)
            middle = place.at(place.width_mm / 2, place.height_mm / 2)
            reach = float(np.linalg.norm(_BOARD_LAMP_MM - middle))
            raw = studio.raw(lamp_at(_BOARD_LAMP_MM, reach, 1.0))
            self._write("board", f"board_{k + 1:02d}", raw, [self._time(raw)])

    def lamps_and_chart(self) -> None:
        """The specimen under every lamp; the chart; masks and normals."""
        plan = self._plan
        peak, studio, view = 0.0, None, -1
        with TemporaryFile() as file:  # a hundred photographs do not fit into memory
            shape = len(plan.shots), *plan.camera.size, 3
            raws = np.memmap(file, np.float32, shape=shape)
            if plan.reference is not None:
                self._reference(self._studio(plan.reference))
            for k, shot in enumerate(plan.shots):
                if studio is None or shot.view != view:
                    studio, view = self._studio(plan.views[shot.view]), shot.view
                    measured = np.maximum(studio.mask(SPECIMEN), studio.mask(WHITE)) > 0.5
                if k == 0 and plan.reference is None:
                    self._write_masks(studio)
                    self._chart(studio)
                raws[k] = studio.raw(plan.lamps[shot.lamp])
                peak = max(peak, float(raws[k][measured].max()))
                if shot.view == 0 and plan.reference is None:
                    self._write_ball(shot.lamp, raws[k])
            brightest = _PEAK / (peak * plan.camera.sensitivity)
            seconds = [brightest * 4.0**s for s in range(self._options.stack)]
            for shot, raw in zip(plan.shots, raws, strict=True):
                self._write("lamp", shot.name, raw, seconds)

    def _reference(self, studio: Studio) -> None:
        """Masks, the chart, and every lamp in the chrome balls, from one place."""
        self._write_masks(studio)
        self._chart(studio)
        for number, lamp in enumerate(self._plan.lamps):
            self._write_ball(number, studio.raw(lamp))

    def _write_ball(self, lamp: int, raw: NDArray[Any]) -> None:
        """So short that the lamp's image in the chrome ball is not clipped: its middle counts."""
        self._write(
            "ball",
            f"ball_{lamp + 1:0{2 if self._plan.reference is None else 3}d}",
            raw,
            [self._time(raw)],
        )

    def _studio(self, view: View) -> Studio:
        plan, points = self._plan, self._options.points
        things, balls, material = plan.things, plan.balls, self._material
        if plan.reference is not None and view is not plan.reference:
            things, balls = things_beside(things), {}
        return Studio(self._mi, things, balls, material, plan.camera, view, points=points)

    def _chart(self, studio: Studio) -> None:
        raw = studio.raw(self._plan.chart_lamp)
        chart = studio.mask("chart") > 0.99
        seconds = _PEAK / (float(raw[chart].max()) * self._plan.camera.sensitivity)
        self._write("chart", "chart", raw, [seconds / 4, seconds])

    def _time(self, raw: Floats) -> float:
        return float(_PEAK / (raw.max() * self._plan.camera.sensitivity))

    def _write(self, kind: str, name: str, raw: NDArray[Any], seconds: list[float]) -> None:
        for k, time in enumerate(seconds):
            file = f"{name}.png" if len(seconds) == 1 else f"{name}_{k + 1}.png"
            stored = self._plan.camera.photograph(raw, time, self._rng)
            write_photograph(self._folder / file, stored, time)
            self.names[kind].append(file)
            self.seconds[file] = time
        self._count += 1
        self._done(min(1.0, 0.95 * self._count / self._all))

    def _write_masks(self, studio: Studio) -> None:
        for name in self._plan.masks:
            grey = np.rint(255 * np.clip(studio.mask(name), 0, 1)).astype(np.uint8)
            write_pixels(grey, self._folder / f"mask_{name}.png")
        normal = studio.normals()
        channels = {f"normal.{c}": normal[..., i].astype(np.float32) for i, c in enumerate("XYZ")}
        write_channels(self._folder / "truth_normals.exr", channels)
