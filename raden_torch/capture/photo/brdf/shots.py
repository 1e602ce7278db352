"""The photographs of a series, before they are read: which files, lamp and pose of the board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from raden_torch.capture.photo.brdf.capture_settings import CaptureSetup
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.capture.photo.development import Development
from raden_torch.capture.photo.lamps import Lamps
from raden_torch.capture.photo.photo_set import lamp_numbers, turned_mask
from raden_torch.capture.photo.photograph import stated_orientation
from raden_torch.errors import InputError


@dataclass(frozen=True, eq=False)
class Shot:
    """One view under one lamp.

    Attributes:
        files: one, or an exposure stack.
        lamp: its number in the lights file, from 0.
        pose: of the board, or None where it is not known.
        how: how the files are read.
    """

    files: tuple[Path, ...]
    lamp: int
    pose: Pose | None
    how: Development

    @property
    def name(self) -> str:
        return self.files[0].name


def shots_of(
    files: Sequence[Path],
    setup: CaptureSetup,
    lamps: Lamps,
    poses: Mapping[str, Pose],
    camera: Camera | None = None,
) -> list[Shot]:
    """Tell the files apart: photograph k under lamp k, or under the one that `setup` says.

    Args:
        setup: with exposure times for each file, for those of one stack, or none.
        lamps: those of its lights file.
        poses: of the board, by file name; one alone serves all photographs; photographs without
            one have None.
        camera: whose orientation photographs with a pose follow that states none itself.

    Raises:
        InputError: numbers that do not fit, a lamp that is not in the list.
    """
    if not files:
        raise InputError("photographs: expected one per lamp, got none")
    stack = setup.stack
    if stack < 1 or len(files) % stack:
        raise InputError(
            f"{files[-1]}: expected a whole number of stacks of {stack}, got {len(files)} files"
        )
    groups = [tuple(files[i : i + stack]) for i in range(0, len(files), stack)]
    chosen = _lamps(groups, lamps, setup.lights, setup.lamps)
    ways = _ways(groups, setup.development)
    return [
        _shot(group, lamp, _pose(group, poses), way, camera)
        for group, lamp, way in zip(groups, chosen, ways, strict=True)
    ]


def _shot(
    files: tuple[Path, ...],
    lamp: int,
    pose: Pose | None,
    how: Development,
    camera: Camera | None,
) -> Shot:
    if pose is not None and pose.orientation is not None:
        how = replace(how, orientation=pose.orientation)
    elif pose is not None and camera is not None:
        how = replace(how, frame_orientation=camera.orientation)
    return Shot(files, lamp, pose, how)


def check_masks(shots: Sequence[Shot], masks: Sequence[Path | None]) -> None:
    """Masks are painted over photographs as their own files turn them.

    Raises:
        InputError: a mask beside a photograph that is read in another orientation.
    """
    mask = next((mask for mask in masks if mask is not None), None)
    for shot in shots:
        wanted = shot.how.orientation or shot.how.frame_orientation
        if mask is None or wanted is None:
            continue
        own = stated_orientation(shot.files[0])
        if own is not None and own != wanted:
            advice = "say where sample and white lie on the board, or take all photographs with "
            advice += "the camera held alike"
            raise turned_mask(mask, wanted, shot.files[0], own, advice)


def _lamps(
    groups: Sequence[tuple[Path, ...]], lamps: Lamps, lights: Path, numbers: Sequence[int]
) -> list[int]:
    count = len(lamps)
    if numbers:
        if len(numbers) != len(groups):
            raise InputError(
                f"lamp numbers: expected one for each of {len(groups)} photographs, got "
                f"{len(numbers)}"
            )
        for group, number in zip(groups, numbers, strict=True):
            if not 1 <= number <= count:
                raise InputError(
                    f"{group[0]}: lamp: expected a number from 1 to {count} ({lights} has {count} "
                    f"lamps), got {number}"
                )
        return [number - 1 for number in numbers]
    if lamps.photographs:
        return _lamps_by_name(groups, lamps, lights)
    if len(groups) > count:
        raise InputError(
            f"{groups[count][0]}: its lamp is not in {lights}, which has {count} lamps for "
            f"{len(groups)} photographs; say which lamp each one was taken under, or find the lamps"
        )
    if len(groups) < count:
        raise InputError(
            f"{lights}: expected one lamp per photograph, in their order, or each photograph's "
            f"lamp number, got {count} lamps for {len(groups)} photographs"
        )
    _check_names(groups, lamps, lights)
    return list(range(count))


def _lamps_by_name(groups: Sequence[tuple[Path, ...]], lamps: Lamps, lights: Path) -> list[int]:
    """As the lights file names each lamp's photographs."""
    by_name = {name: k for k, names in enumerate(lamps.photographs) for name in names}
    for group in groups:
        if group[0].name not in by_name:
            raise InputError(
                f"{group[0]}: expected a photograph that {lights} names, got another; say which "
                "lamp each one was taken under"
            )
    return [by_name[group[0].name] for group in groups]


def _check_names(groups: Sequence[tuple[Path, ...]], lamps: Lamps, lights: Path) -> None:
    """Numbers in the names that say another order, or a lamp that the file has not."""
    own = lamp_numbers([group[0].name for group in groups])
    theirs = lamp_numbers(lamps.names)
    if own is None or theirs is None or own == theirs:
        return
    if set(own) == set(theirs):
        k = next(k for k, (a, b) in enumerate(zip(own, theirs, strict=True)) if a != b)
        raise InputError(
            f"{groups[k][0]}: it is photograph {k + 1}, but lamp {k + 1} of {lights} was found in "
            f"{lamps.names[k]}; give the photographs in the lamps' order, or each one's lamp"
        )


def _ways(groups: Sequence[tuple[Path, ...]], how: Development) -> list[Development]:
    size, times = len(groups[0]), how.exposures_s
    if len(times) not in (0, size, size * len(groups)):
        raise InputError(
            f"exposure times: expected none, {size} or {size * len(groups)} for {len(groups)} "
            f"photographs of {size} files, got {len(times)}"
        )
    if len(times) == size:
        return [how] * len(groups)
    return [replace(how, exposures_s=times[i * size : (i + 1) * size]) for i in range(len(groups))]


def _pose(group: tuple[Path, ...], poses: Mapping[str, Pose]) -> Pose | None:
    """The pose in the photograph itself; one alone in the file serves all, as nothing moves."""
    if not poses:
        return None
    found = next((poses[path.name] for path in group if path.name in poses), None)
    return next(iter(poses.values())) if found is None and len(poses) == 1 else found
