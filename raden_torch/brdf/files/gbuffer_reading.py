"""What has to be said of a G-buffer's file beside its channels: names, camera, kinds, axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike
from torch import Tensor

from raden_torch.brdf.files.camera_pose import header_pose, read_pose
from raden_torch.brdf.files.gbuffer_frame import GBufferFrame, NormalSpace, PositionSpace
from raden_torch.brdf.files.normal_axes import NormalAxes
from raden_torch.brdf.files.world_axes import World, one_of
from raden_torch.brdf.shading.depth import MAX_SMOOTH_PX, depth_kind
from raden_torch.brdf.shading.lights import Light
from raden_torch.brdf.shading.triples import Triple, check_direction
from raden_torch.errors import InputError
from raden_torch.images.exr_header import Part


@dataclass(frozen=True, eq=False)
class GBufferReading:
    """How the G-buffer in an EXR file is to be read.

    The direction to the viewer is, the first that is given: `view`; from positions to `camera`; a
    pinhole's, by `intrinsics` or `fov_deg`; (0, 0, 1), a camera at infinity that looks along −z.

    Vectors in world space become those of a world with y up, the G-buffer's frame; so do `camera`
    and `view`. They need a camera: `camera` with positions, a camera file, or the header's.

    Attributes:
        channels: layers by name, `{"normal": "MyLayer", "position": …, "depth": "Z2", "mask": …}`;
            a vector's three channels also as "nx,ny,nz". Others are found by their usual names.
        intrinsics: `[3, 3]` pinhole matrix in pixels of the display window, y down.
        fov_deg: instead, the horizontal angle of view around the centre, degrees, 0…180 without
            its ends; the header's pixel aspect ratio makes it the vertical one.
        camera: `[3]`, the viewer's position, in units of the positions, for a file with positions.
        view: `[3]` towards a viewer at infinity, or a map `[1, 3, H, W]`; any length but 0.
        smooth_px: standard deviation of a Gaussian over the depth before normals are made of it,
            0…`MAX_SMOOTH_PX` pixels; depth in half precision needs several.
        depth: what the depth is, one of `depth.KINDS`: "planar", "distance" along the pixel's ray,
            "negative", or the renderer that wrote it. None is planar, and warns where the surface
            indicates another.
        material: a file of its own that says which material of a palette each pixel shows; without
            it the EXR's layer "material" does (`channels`, `MaterialMap`).
        xyz: the channels of the normals that hold x, y and z ("r" is the first of the three), with
            a minus where one points the other way: "r,-g,-b" for a camera with y down, z forward.
        space: of the normals: "camera"; "world"; or "tangent", in the plane of the layers "surface"
            and "tangent", or without these of a flat surface that faces the camera.
        position_space: of the positions (and of "surface" and "tangent"): "camera" or "world"; the
            normals' unless stated.
        world: the renderer's axes: "y-up", "z-up", or "unreal" (z up, left-handed).
        camera_file: JSON that says where the camera stands and looks (`camera_pose.read_pose`).
        tangent: the direction of the sample's azimuth 0 in every pixel, of which the part in the
            surface counts; without it the EXR's layer "tangent" says it (`channels`).

    Raises:
        InputError: a value out of its range, or both `view` and `camera`.
    """

    channels: Mapping[str, str] | None = None
    intrinsics: Tensor | ArrayLike | None = None
    fov_deg: float | None = None
    camera: Triple | None = None
    view: Tensor | Triple | None = None
    smooth_px: float = 0.0
    depth: str | None = None
    xyz: str = "r,g,b"
    material: Path | None = None
    space: NormalSpace = "camera"
    position_space: PositionSpace | None = None
    world: World = "y-up"
    camera_file: Path | None = None
    tangent: Triple | None = None

    def __post_init__(self) -> None:
        if self.view is not None and self.camera is not None:
            raise InputError("view, camera: expected view or camera, got both")
        if not 0 <= self.smooth_px <= MAX_SMOOTH_PX:
            raise InputError(
                f"smooth_px: expected 0…{MAX_SMOOTH_PX:g} pixels, got {self.smooth_px:g}"
            )
        if self.tangent is not None:
            if "tangent" in (self.channels or {}):
                raise InputError("tangent: expected a direction or a layer, got both")
            check_direction("tangent", self.tangent)
        depth_kind(self.depth or "planar")
        NormalAxes.of(self.xyz)
        one_of("space", self.space, NormalSpace)
        one_of("world", self.world, World)
        if self.position_space is not None:
            one_of("position_space", self.position_space, PositionSpace)

    @property
    def axes(self) -> NormalAxes:
        """What `xyz` says."""
        return NormalAxes.of(self.xyz)

    def frame(self, path: object, part: Part) -> GBufferFrame:
        """Where a file's vectors go, by its header where no camera file is given.

        Raises:
            InputError: the camera file, or the header's matrix, is wrong.
        """
        positions = self.position_space or ("world" if self.space == "world" else "camera")
        frame = GBufferFrame(self.space, positions, self.world)
        if self.camera_file is not None:
            return replace(frame, pose=read_pose(self.camera_file, self.world))
        return replace(frame, pose=header_pose(path, part, self.world) if frame.is_world else None)

    def light(self, light: Light) -> Light:
        """A lamp of the renderer's world in the frame of the G-buffer.

        Environments stay as they are, with y up.
        """
        frame = GBufferFrame(self.space, self.position_space or "camera", self.world)
        vectors = ("direction", "position", "target", "across", "up", "facing")
        places: dict[str, Any] = {
            name: frame.of_triple(name, getattr(light, name))
            for name in vectors
            if hasattr(light, name)
        }
        return replace(light, **places)


USUAL = GBufferReading()
"""The usual names, planar depth, a camera at infinity."""
