"""Which of the pictures that may be kept are: those that look from the most different places."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.camera import Pose

_DISTANCE_DEG = 10.0
"""A distance that differs by a half counts as much as a direction that differs by this."""


def spread_out(
    poses: Sequence[Pose], middle_m: Floats, clips: Sequence[int], most: int
) -> list[int]:
    """Numbers of the chosen, in order: farthest-point sampling of the places of the camera, in each
    clip by itself; each clip has an equal share, as far as it has pictures.

    Args:
        poses: of the pictures that may be kept.
        middle_m: `[3]` of the piece on the board.
        clips: of each picture.
        most: pictures in all, 1 or more.
    """
    places = np.array([_place(pose, middle_m) for pose in poses])
    groups = [np.flatnonzero(np.array(clips) == clip) for clip in sorted(set(clips))]
    chosen: list[int] = []
    left = most
    for done, group in enumerate(sorted(groups, key=len)):
        share = min(len(group), left // (len(groups) - done))
        chosen += [int(group[k]) for k in _farthest(places[group], share)]
        left -= share
    return sorted(chosen)


def _place(pose: Pose, middle_m: Floats) -> Floats:
    """`[4]`: the direction to the camera, and its distance as a like number."""
    to_camera = -pose.rotation.T @ pose.translation_m - middle_m
    reach = float(np.linalg.norm(to_camera))
    return np.append(to_camera / reach, np.radians(_DISTANCE_DEG) * np.log(reach) / np.log(1.5))


def _farthest(places: Floats, count: int) -> list[int]:
    if count < 1:
        return []
    chosen = [int(np.linalg.norm(places - places.mean(axis=0), axis=1).argmax())]
    away = np.linalg.norm(places - places[chosen[0]], axis=1)
    away[chosen] = -1.0
    while len(chosen) < count:
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(places - places[chosen[-1]], axis=1))
        away[chosen] = -1.0
    return chosen
