"""What an error of the board's pose does: sample, white and lamps that are on it, carried along.

Each pose has six independent errors (`Pose.errors`). That of one photograph carries the sample and
the white, and the lamps that stand beside the board; that of the photograph in which the lamps were
found sets all of these elsewhere on the board.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.lighting import Lamp
from raden_torch.capture.photo.brdf.photo_series import PhotoSeries
from raden_torch.capture.photo.brdf.rays import carried
from raden_torch.capture.photo.brdf.sample_shapes import Cylinder, Plane, Planes, Shape
from raden_torch.capture.photo.brdf.white_sight import WhiteSight
from raden_torch.capture.photo.camera import Pose


@dataclass(frozen=True, eq=False)
class PoseError:
    """A pose and one error of it: `[6]`, one standard deviation, as `Pose.moved` takes it."""

    pose: Pose
    by: Floats

    def concerns(self, series: PhotoSeries, number: int) -> bool:
        """Whether it changes anything in that shot."""
        return self.pose is series.shots[number].pose or self.pose is series.seen_in

    def of(self, pose: Pose) -> Pose:
        """A pose, as this error has it."""
        return pose.moved(self.by) if pose is self.pose else pose


def pose_errors(series: PhotoSeries) -> Iterator[list[PoseError]]:
    """Those of each pose that the series has."""
    poses = {id(p): p for p in (*(shot.pose for shot in series.shots), series.seen_in) if p}
    for pose in poses.values():
        yield [PoseError(pose, by) for by in pose.errors()]


def carried_shape(shape: Shape, before: Pose, after: Pose) -> Shape:
    """A shape that lies on the board, as it is at another pose."""
    if isinstance(shape, Planes):
        return Planes(tuple(_carried_plane(part, before, after) for part in shape.parts))
    if isinstance(shape, Plane):
        return _carried_plane(shape, before, after)
    assert isinstance(shape, Cylinder)
    point, axis = (
        carried(shape.point, before, after),
        carried(shape.axis, before, after, point=False),
    )
    return replace(shape, point=point, axis=axis)


def carried_lamp(lamp: Lamp, error: PoseError, pose: Pose, seen_in: Pose | None) -> Lamp:
    """A lamp in the frame of a shot, as an error of a pose has it.

    Args:
        pose: of the board in that shot.
        seen_in: in the photograph in whose frame the lamps were found; None: they stand beside the
            camera.
    """
    if seen_in is None:
        return lamp
    return lamp.carried(pose, seen_in).carried(error.of(seen_in), error.of(pose))


def change_on_white(
    sight: WhiteSight | None,
    before: tuple[Lamp, Floats],
    after: tuple[Lamp, Floats],
    poses: tuple[Pose, Pose],
) -> float:
    """The share by which the light on the white grows; 0 where the white was not read.

    Args:
        before, after: the lamp and the sample's middle.
        poses: of the board, before and after.
    """
    if sight is None:
        return 0.0
    plane = _carried_plane(sight.plane, *poses) if sight.on_board else sight.plane
    return sight.change(before, after, plane)


def _carried_plane(plane: Plane, before: Pose, after: Pose) -> Plane:
    return Plane(
        carried(plane.corners, before, after), carried(plane.normal, before, after, point=False)
    )
