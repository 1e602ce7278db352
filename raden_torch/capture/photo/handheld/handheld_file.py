"""What `raden capture handheld` found, as files for `raden capture brdf` and for a person."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.rays import MM, Y_UP
from raden_torch.capture.photo.camera import Pose, write_camera
from raden_torch.capture.photo.capture_handheld import Handheld
from raden_torch.capture.photo.handheld.footage import pictures
from raden_torch.capture.photo.handheld.response_fit import write_response
from raden_torch.capture.photo.lamps import Lamps, write_lamps
from raden_torch.capture.photo.result_file import read_result, write_result
from raden_torch.errors import InputError
from raden_torch.files import check_writable
from raden_torch.images.pixels import write_pixels

_FRAME = re.compile(r".*_\d{6}\.png")
_LEAST_STD_DEG = 0.05


@dataclass(frozen=True)
class HandheldPaths:
    """Where each part lies in a folder."""

    folder: Path

    @property
    def frames(self) -> Path:
        return self.folder / "frames"

    @property
    def camera(self) -> Path:
        return self.folder / "camera.json"

    @property
    def lights(self) -> Path:
        return self.folder / "lights.json"

    @property
    def response(self) -> Path:
        return self.folder / "response.json"

    @property
    def report(self) -> Path:
        return self.folder / "handheld.json"

    @property
    def picture(self) -> Path:
        return self.folder / "handheld.png"

    @property
    def all(self) -> tuple[Path, ...]:
        return self.camera, self.lights, self.response, self.report, self.picture


def write_handheld(found: Handheld, folder: Path) -> list[Path]:
    """Write everything but the picture; frames of an earlier run are taken away.

    Returns:
        The kept photographs: stills where they are, frames of videos in `folder/frames`.
    """
    paths = HandheldPaths(folder)
    folder.mkdir(parents=True, exist_ok=True)
    photographs = _photographs(found, paths.frames, _frames_of(paths.report))
    views = [each.view for each in found.kept]
    write_camera(
        paths.camera,
        found.camera,
        [view for view in views if view is not None],
        _poses(found),
        calibration=found.calibration,
        made_from=photographs,
    )
    write_lamps(_lamps(found), paths.lights, made_from=photographs)
    if found.response is not None:
        write_response(found.response, paths.response, made_from=photographs)
    else:
        paths.response.unlink(missing_ok=True)
    write_result(paths.report, "handheld", _report(found), made_from=[c.name for c in found.clips])
    return photographs


def _poses(found: Handheld) -> list[Pose]:
    """With the orientation by which stills are to be turned, where their files say another."""
    if not any(each.other_way for each in found.kept):
        return found.poses
    way = [None if found.clips[k.clip].video else found.camera.orientation for k in found.kept]
    return [replace(pose, orientation=w) for pose, w in zip(found.poses, way, strict=True)]


def next_command(
    found: Handheld,
    paths: HandheldPaths,
    photographs: Sequence[Path],
    response: Path | None,
    white_factor: str | None = None,
) -> str:
    """What makes a measurement of it.

    Args:
        photographs: as `write_handheld` gave them.
        response: a response file that was given.
        white_factor: of the white; None: "FACTOR" stands for it.
    """
    setup = found.setup
    curve = paths.response if found.response is not None else response
    words = [
        "raden capture brdf",
        _as_patterns(photographs, paths.frames),
        f"--camera {shlex.quote(str(paths.camera))} --lights {shlex.quote(str(paths.lights))}",
        *([] if setup.lamp_on_camera else [
            f"--lamps-stand board --lights-seen-in {shlex.quote(photographs[0].name)}"
        ]),
        *([] if curve is None else [f"--response-file {shlex.quote(str(curve))}"]),
        f"--shape plane --region '{_points(setup.region_m)}'",
        f"--white-region '{_points(setup.white_m)}' "
        f"--white-factor {white_factor or 'FACTOR'} --scattered -o shell.csv",
    ]  # fmt: skip
    return " \\\n    ".join(words)


def _as_patterns(photographs: Sequence[Path], frames: Path) -> str:
    """Frames by their folder, stills by their names."""
    stills = [shlex.quote(str(path)) for path in photographs if path.parent != frames]
    pattern = [f"{shlex.quote(str(frames))}/*.png"] if len(stills) < len(photographs) else []
    return " ".join([*pattern, *stills])


def _points(corners: Floats) -> str:
    return " ".join(",".join(f"{value:g}" for value in corner) for corner in corners)


def _photographs(found: Handheld, frames: Path, earlier: set[str]) -> list[Path]:
    written: list[Path] = []
    for place, clip in enumerate(found.clips):
        kept = [each for each in found.kept if each.clip == place]
        if not kept:
            continue
        if clip.video is None:
            written += [clip.stills[each.number] for each in kept]
            continue
        frames.mkdir(exist_ok=True)
        for picture in pictures(clip, place, {each.number for each in kept}):
            write_pixels(picture.pixels, frames / picture.name)
            written.append(frames / picture.name)
    names = {path.name for path in written}
    for old in earlier - names:
        if _FRAME.fullmatch(old):
            (frames / old).unlink(missing_ok=True)
    return written


def _frames_of(report: Path) -> set[str]:
    """Names of the pictures that an earlier run kept; none where there was no such run."""
    if not report.is_file():
        return set()
    try:
        earlier = read_result(report, "handheld", _EarlierRun)
    except InputError:
        return set()
    return {each.picture for each in earlier.pictures if each.kept}


class _EarlierPicture(Struct):
    picture: str
    kept: bool


class _EarlierRun(Struct):
    pictures: tuple[_EarlierPicture, ...]


def check_folder(folder: Path, footage: Sequence[Path]) -> None:
    """Raise InputError where the result could not be written, or would meet the footage."""
    frames = HandheldPaths(folder).frames.resolve()
    for path in footage:
        if frames in (path.resolve(), path.resolve().parent):
            raise InputError(
                f"{path}: expected footage outside of {folder / 'frames'}, into which frames are "
                "written; give another output folder"
            )
    existing = next(p for p in (folder, *folder.resolve().parents) if p.exists())
    if not existing.is_dir():
        raise InputError(f"{folder}: expected a folder, got a file in its place")
    check_writable(existing / "camera.json")


def _lamps(found: Handheld) -> Lamps:
    """In the frame of the camera: of every photograph, where the lamp is fixed to it, else of the
    first one."""
    middle = found.setup.middle_m
    turn, shift = found.poses[0].rotation, found.poses[0].translation_m
    position = np.array([lamp.at_m for lamp in found.lamps])
    if not found.setup.lamp_on_camera:
        position = position @ turn.T + shift
    away = (position - (turn @ middle + shift)) * Y_UP
    kept, names = found.kept, []
    for lamp in range(len(found.lamps)):
        own = zip(kept, found.lamp_of, strict=True)
        names.append(tuple(each.name for each, number in own if number == lamp))
    return Lamps(
        away / np.linalg.norm(away, axis=1, keepdims=True),
        np.ones(len(away)),
        MM * position * Y_UP,
        unit="mm",
        names=tuple(own[0] for own in names),
        notes=found.notes,
        matrix=found.camera.matrix,
        distortion=found.camera.distortion,
        orientation=found.camera.orientation,
        std_deg=np.array([max(lamp.std_deg, _LEAST_STD_DEG) for lamp in found.lamps]),
        photographs=tuple(names),
    )


def _report(found: Handheld) -> dict[str, Any]:
    exposure = dict(zip(found.chosen, found.exposures, strict=True))
    pose_of = dict(zip(found.chosen, found.poses, strict=True))
    looked = []
    for k, each in enumerate(found.looked_at):
        entry: dict[str, Any] = {
            "picture": each.name,
            "clip": found.clips[each.clip].name,
            "kept": k in exposure,
            "refused": each.refused or ("" if k in exposure else "others show as much"),
        }
        if each.blur is not None:
            entry["blur_px"] = [
                round(each.blur.across_rows, 2),
                round(each.blur.across_columns, 2),
            ]
        if k in exposure:
            entry["exposure_rgb"] = np.round(exposure[k], 4)
            entry["reprojection_rms_px"] = round(pose_of[k].rms_px, 3)
        looked.append(entry)
    lamps = [
        {
            "frame": "camera" if found.setup.lamp_on_camera else "board",
            "position_m": np.round(lamp.at_m, 5),
            "direction_std_deg": round(lamp.std_deg, 3),
            "images": lamp.images,
            "images_left_out": lamp.left_out,
            "image_rms_px": round(lamp.image_rms_px, 3),
            "light_on_squares_rms": round(lamp.level_rms, 4),
            "balls_touch_m": np.round(lamp.balls_m, 5),
        }
        for lamp in found.lamps
    ]
    return {"notes": list(found.notes), "lamps": lamps, "pictures": looked}
