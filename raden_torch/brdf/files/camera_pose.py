"""Where a renderer's camera stood: from a small JSON file, or from the header of an EXR."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from raden_torch.brdf.files.world_axes import TO_Y_UP, World, in_y_up
from raden_torch.errors import InputError
from raden_torch.images.exr_header import Part
from raden_torch.schema import Finite, Matrix, Triple, checked, read_document

Floats = NDArray[np.float64]
_Row = tuple[Finite, Finite, Finite, Finite]
_ROUNDING = 1e-3


class CameraFile(Struct, forbid_unknown_fields=True):
    """What a camera file may say, in the renderer's own world: `camera_to_world`, or `position`
    and `target`; and the lens, for depth."""

    camera_to_world: tuple[_Row, _Row, _Row, _Row] | None = None
    position: Triple | None = None
    target: Triple | None = None
    up: Triple | None = None
    fov_deg: Annotated[float, Meta(gt=0, lt=180)] | None = None
    intrinsics: Matrix | None = None


@dataclass(frozen=True)
class CameraPose:
    """A camera in the world with y up.

    Attributes:
        origin: `[3]`, where it stands.
        axes: `[3, 3]`, whose columns are the camera's right, up and backward direction (to the
            viewer), unit vectors; None where only the position is known.
        fov_deg: the horizontal angle of view, where it is known.
        intrinsics: `[3, 3]` in pixels, y down, where it is known.
    """

    origin: Floats
    axes: Floats | None = None
    fov_deg: float | None = None
    intrinsics: Matrix | None = None


def read_pose(path: str | os.PathLike[str], world: World) -> CameraPose:
    """The camera in a JSON file, which speaks of the renderer's own world.

    Either `camera_to_world`, four rows of four numbers for column vectors, of a camera that looks
    along its −z with y up (Blender's `matrix_world`, the transposed transform of a USD camera); or
    `position` and `target`, with `up` where it is not the world's.

    Raises:
        InputError: not such a file; a matrix that scales unevenly or shears, or one of a
            left-handed world; a target at the position, or straight above or below it.
    """
    held = checked(read_document(path, "a camera file"), CameraFile, str(path))
    lens = (held.fov_deg, held.intrinsics)
    if None not in lens:
        raise InputError(f"{path}: expected fov_deg or intrinsics, got both")
    to_y_up = np.asarray(TO_Y_UP[world], np.float64)
    if (held.camera_to_world is None) == (held.position is None):
        raise InputError(f"{path}: expected camera_to_world, or position and target")
    if held.camera_to_world is not None:
        if world == "unreal":
            raise InputError(
                f"{path}: expected position and target in a left-handed world, got camera_to_world"
            )
        matrix = np.asarray(held.camera_to_world)
        axes = _rigid(matrix[:3, :3], f"{path}: camera_to_world")
        return CameraPose(to_y_up @ matrix[:3, 3], to_y_up @ axes, *lens)
    assert held.position is not None
    origin = np.asarray(in_y_up(held.position, world))
    if held.target is None:
        return CameraPose(origin, None, *lens)
    back = origin - np.asarray(in_y_up(held.target, world))
    up = (0.0, 1.0, 0.0) if held.up is None else in_y_up(held.up, world)
    right = np.cross(up, back)
    if not np.linalg.norm(right) > 0:
        raise InputError(
            f"{path}: expected a target away from the position, and not straight above or below "
            "it unless `up` says where the top of the picture points"
        )
    axes = np.stack([right, np.cross(back, right), back], axis=1)
    return CameraPose(origin, axes / np.linalg.norm(axes, axis=0), *lens)


def header_pose(path: object, part: Part, world: World) -> CameraPose | None:
    """The camera in OpenEXR's standard attributes, None where there is none.

    `worldToCamera` maps row vectors to the camera's space, of which renderers disagree whether it
    looks along z or −z. The position is the same in both; which way it looks is taken from
    `worldToNDC`, whose fourth column grows in front of a camera with perspective.

    Raises:
        InputError: a matrix that scales unevenly or shears.
    """
    if part.world_to_camera is None:
        return None
    to_y_up = np.asarray(TO_Y_UP[world], np.float64)
    matrix = np.asarray(part.world_to_camera, np.float64).reshape(4, 4)
    where = f"{path}: worldToCamera"
    axes = _rigid(matrix[:3, :3], where)
    origin = to_y_up @ (-matrix[3, :3] @ np.linalg.inv(matrix[:3, :3]))
    forward = np.zeros(3)
    if part.world_to_ndc is not None:
        forward = np.asarray(part.world_to_ndc, np.float64).reshape(4, 4)[:3, 3]
    if not np.linalg.norm(forward) > 0:
        return CameraPose(origin)
    if axes[:, 2] @ forward > 0:  # it looks along z
        axes = axes * np.array([1.0, 1.0, -1.0])
    return CameraPose(origin, to_y_up @ axes)


def _rigid(matrix: Floats, where: str) -> Floats:
    """The matrix without its scale.

    Raises:
        InputError: its columns are no perpendicular directions of one length.
    """
    scale = np.cbrt(abs(np.linalg.det(matrix)))
    if not scale > 0 or np.abs(matrix.T @ matrix / scale**2 - np.eye(3)).max() > _ROUNDING:
        raise InputError(f"{where}: expected a rotation and a position, got {matrix.tolist()}")
    return matrix / scale
