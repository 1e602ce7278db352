"""In which axes a G-buffer's vectors are stored, and the frame that they are brought into.

The frame is the camera's (x right, y up, z to the viewer) where all vectors are in the camera's
space, else the world with y up.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from raden_torch.brdf.files.camera_pose import CameraPose
from raden_torch.brdf.files.world_axes import TO_Y_UP, World
from raden_torch.brdf.shading.triples import Triple, checked
from raden_torch.errors import InputError
from raden_torch.geometry import normalised

NormalSpace = Literal["camera", "world", "tangent"]
PositionSpace = Literal["camera", "world"]


@dataclass(frozen=True)
class GBufferFrame:
    """How the vectors of one file come into one frame.

    Attributes:
        normals, positions: the spaces that they are stored in.
        world: the axes of the renderer's world.
        pose: the camera in the world with y up, where it is known.
    """

    normals: NormalSpace = "camera"
    positions: PositionSpace = "camera"
    world: World = "y-up"
    pose: CameraPose | None = None

    @property
    def is_world(self) -> bool:
        """Whether the frame is the world's."""
        return "world" in (self.normals, self.positions)

    @property
    def camera(self) -> tuple[float, float, float] | None:
        """Where the camera is in the frame, if that is known."""
        if not self.is_world:
            return (0.0, 0.0, 0.0)
        if self.pose is None:
            return None
        x, y, z = self.pose.origin.tolist()
        return x, y, z

    def of_camera(self, vectors: Tensor) -> Tensor:
        """`[B, 3, H, W]` directions in the camera's axes, in the frame.

        Raises:
            InputError: the world's axes are needed and the camera's are unknown.
        """
        if not self.is_world:
            return vectors
        if self.pose is None or self.pose.axes is None:
            raise InputError(
                "camera: expected which way it looks, to bring its rays and vectors into the "
                "world; give a camera file with camera_to_world, or with position and target"
            )
        return _turned(torch.from_numpy(self.pose.axes), vectors)

    def of_normals(self, stored: Tensor, surface: Tensor | None, tangent: Tensor | None) -> Tensor:
        """`[B, 3, H, W]` normals in the frame.

        Args:
            stored: as the file has them, decoded.
            surface, tangent: for normals in tangent space, the surface's normal and the direction
                of the map's x, in the space of the positions: n = x t + y (s × t) + z s.
        """
        if self.normals == "tangent":
            if surface is None or tangent is None:
                return stored  # a flat surface that faces the camera
            s = normalised(surface)
            t = normalised(tangent - (tangent * s).sum(1, keepdim=True) * s)
            x, y, z = (stored[:, c : c + 1] for c in range(3))
            stored = x * t + y * torch.linalg.cross(s, t, dim=1) + z * s
            return self._of_space(stored, self.positions)
        return self._of_space(stored, self.normals)

    def of_viewer(self, view: Tensor) -> Tensor:
        """`[B, 3, H, W]` directions to the viewer, as the user gives them: in the world's own axes
        where the frame is the world's."""
        return self._of_space(view, "world") if self.is_world else view

    def of_triple(self, name: str, vector: Triple) -> Triple:
        """A place or direction that the user gives, `[3]`, likewise."""
        if not self.is_world or self.world == "y-up":
            return vector
        return checked(name, vector).float() @ torch.tensor(TO_Y_UP[self.world]).T.float()

    def of_positions(self, stored: Tensor) -> Tensor:
        """`[B, 3, H, W]` positions in the frame."""
        return self._of_space(stored, self.positions)

    def _of_space(self, vectors: Tensor, space: str) -> Tensor:
        if space == "camera":
            return self.of_camera(vectors)
        if self.world == "y-up":
            return vectors
        return _turned(torch.tensor(TO_Y_UP[self.world]), vectors)


def _turned(matrix: Tensor, vectors: Tensor) -> Tensor:
    return torch.einsum("ij,bjhw->bihw", matrix.to(vectors.dtype), vectors)
