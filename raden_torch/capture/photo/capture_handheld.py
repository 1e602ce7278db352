"""A phone held by hand before a card: what `raden capture handheld` does."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats, Floats32
from raden_torch.capture.photo.brdf.rays import Y_UP
from raden_torch.capture.photo.camera import Calibration, Camera, Pose, read_camera
from raden_torch.capture.photo.handheld.camera_poses import camera_and_poses, too_few
from raden_torch.capture.photo.handheld.choosing import spread_out
from raden_torch.capture.photo.handheld.footage import (
    Clip,
    Picture,
    clips_of,
    in_one_frame,
    pictures,
)
from raden_torch.capture.photo.handheld.handheld_setup import FEWEST, HandheldSetup
from raden_torch.capture.photo.handheld.judging import Judged, judged, reasons
from raden_torch.capture.photo.handheld.lamp_fit import FoundLamp, LampSetting, find_lamp
from raden_torch.capture.photo.handheld.lamp_sights import Sights, sights, white_squares_m
from raden_torch.capture.photo.handheld.response_fit import Response
from raden_torch.capture.photo.handheld.white_and_greys import (
    Places,
    exposures_of,
    places_in,
    response_of,
)
from raden_torch.errors import InputError
from raden_torch.images.colour_space import SRGB_SPACE


@dataclass(frozen=True, eq=False)
class Handheld:
    """What was found.

    Attributes:
        clips: what was given.
        looked_at: every picture that was, with the reason where it is not kept.
        chosen: numbers of the kept in `looked_at`.
        poses: of the board in the kept, in order.
        camera, calibration: the latter None where the camera was given.
        lamps: one, or one a clip of which pictures were kept.
        lamp_of: `[n]` its number for each kept picture.
        response: None where sRGB's, or a given one, was taken.
        exposures: `[n, 3]` light of the white over its irradiance, relative to the median.
        setup: as given, with the board as found.
        notes: what a person should know.
    """

    clips: list[Clip]
    looked_at: list[Judged]
    chosen: list[int]
    poses: list[Pose]
    camera: Camera
    calibration: Calibration | None
    lamps: list[FoundLamp]
    lamp_of: list[int]
    response: Response | None
    exposures: Floats
    setup: HandheldSetup
    notes: tuple[str, ...] = ()

    @property
    def lit(self) -> list[str]:
        """Of each lamp where it shone, as " (walk1.mp4)"; "" of one on the camera."""
        clips = _lit_by(self.setup, [each.clip for each in self.kept])
        return ["" if clip is None else f" ({self.clips[clip].name})" for clip in clips]

    @property
    def kept(self) -> list[Judged]:
        return [self.looked_at[k] for k in self.chosen]

    def lamp_in_camera_m(self, number: int) -> Floats:
        """`[3]` the lamp of a kept picture, in its camera's frame as OpenCV has it."""
        at = self.lamps[self.lamp_of[number]].at_m
        if self.setup.lamp_on_camera:
            return at
        pose = self.poses[number]
        return pose.rotation @ at + pose.translation_m

    def __str__(self) -> str:
        left_out = ", ".join(f"{count} {why}" for why, count in reasons(self.looked_at))
        lines = [
            f"{len(self.chosen)} photographs chosen of {len(self.looked_at)} that were looked at"
            + (f" (left out: {left_out})" if left_out else "")
        ]
        frame = "the camera" if self.setup.lamp_on_camera else "the board"
        for k, lamp in enumerate(self.lamps):
            at = ", ".join(f"{1000 * value:.0f}" for value in lamp.at_m)
            lines.append(
                f"lamp {k + 1}{self.lit[k]}: at {at} mm in the frame of {frame}, direction ± "
                f"{lamp.std_deg:.2f} deg, by {lamp.images} images ({lamp.left_out} left out)"
            )
        if self.response is not None:
            low, high = self.response.known
            lines.append(
                f"tone curve: seen from {low:.0f} to {high:.0f} of 255, "
                f"± {100 * self.response.rms:.1f} %"
            )
        return "\n".join((*lines, *(f"note: {note}" for note in self.notes)))


def capture_handheld(
    paths: Sequence[Path],
    setup: HandheldSetup,
    *,
    progress: Callable[[float], None] | None = None,
) -> Handheld:
    """Choose pictures of videos and stills, and find their camera, lamps and tone curve.

    Args:
        paths: videos, folders of stills, stills. A lamp beside the board stands still in each video
            and each folder, and in all single stills together.
        progress: called with the share that is done, 0…1.

    Raises:
        InputError: as for what it is made of; a bent card; a camera file that does not fit; too few
            pictures left, with the reasons.
    """
    done = progress or (lambda share: None)
    known = None if setup.camera is None else read_camera(setup.camera)
    clips = in_one_frame(clips_of(paths), None if known is None else known.orientation)
    looked = judged(
        clips,
        setup.board,
        most_blur_px=setup.most_blur_px,
        every=setup.every,
        progress=lambda share: done(0.7 * share),
    )
    found_board = next(each.view.board for each in looked if each.view is not None)
    setup = replace(setup, board=found_board)
    camera, calibration, looked, poses = camera_and_poses(looked, setup, known)
    camera = replace(camera, orientation=clips[0].orientation)
    notes = [] if calibration is None else list(calibration.notes)
    done(0.75)
    table = _srgb() if setup.response is None else setup.response
    looked, seen, places, all_srgb = _looked_into(clips, looked, poses, camera, setup, table)
    done(0.9)
    chosen = _chosen(looked, poses, setup)
    if len(chosen) < FEWEST:
        raise InputError(too_few(looked, len(chosen)))
    kept_poses, kept_places = [poses[k] for k in chosen], [places[k] for k in chosen]
    lit = _lit_by(setup, [looked[k].clip for k in chosen])
    groups = [lit.index(None if setup.lamp_on_camera else looked[k].clip) for k in chosen]
    lamps = _lamps(looked, poses, seen, lit, camera, setup, table, clips)
    lamps_m = _on_board(lamps, groups, kept_poses, setup)
    response = None
    if setup.greys:
        response = response_of(kept_places, lamps_m, setup)
        table = response.table
        lamps = _lamps(looked, poses, seen, lit, camera, setup, table, clips)
        lamps_m = _on_board(lamps, groups, kept_poses, setup)
    elif setup.response is None:
        notes.append(
            "the tone curve is taken for sRGB's; a phone's own is often 10 to 30 % off it: grey "
            "patches of known reflectance show it"
        )
    if not all_srgb and (setup.response is not None or response is not None):
        notes.append(
            "the stills' colour profile has other primaries than sRGB's, as Display P3; with a "
            "response file colours are as stored: `raden capture colour --response-file` on a "
            "chart finds their way to XYZ"
        )
    done(0.97)
    exposures = exposures_of(kept_places, lamps_m, setup, table)
    notes += [
        *_turned(clips, looked),
        *_without_pictures(clips, looked, chosen),
        *_said(lamps, lit, exposures, setup, clips),
    ]
    return Handheld(
        clips, looked, chosen, kept_poses, camera, calibration, lamps, groups, response, exposures,
        setup, tuple(notes),
    )  # fmt: skip


def _chosen(looked: Sequence[Judged], poses: dict[int, Pose], setup: HandheldSetup) -> list[int]:
    may = [k for k in poses if not looked[k].refused]
    clips = [looked[k].clip for k in may]
    picked = spread_out([poses[k] for k in may], setup.middle_m, clips, setup.photographs)
    return [may[i] for i in picked] if may else []


def _pictures(
    clips: Sequence[Clip], looked: Sequence[Judged], wanted: Iterable[int]
) -> Iterator[tuple[int, Picture]]:
    """The pictures with these numbers in `looked`, one by one."""
    by_place = {(looked[k].clip, looked[k].number): k for k in wanted}
    for place, clip in enumerate(clips):
        numbers = {number for c, number in by_place if c == place}
        for picture in pictures(clip, place, numbers) if numbers else ():
            yield by_place[place, picture.number], picture


def _looked_into(
    clips: Sequence[Clip],
    looked: list[Judged],
    poses: dict[int, Pose],
    camera: Camera,
    setup: HandheldSetup,
    table: Floats32,
) -> tuple[list[Judged], dict[int, Sights], dict[int, Places], bool]:
    """What every sharp picture shows of its lamp, white and greys; the pictures again, those
    refused whose white does not tell the exposure; and whether all have sRGB's primaries."""
    covered, all_srgb = _covered(setup), True
    seen: dict[int, Sights] = {}
    places: dict[int, Places] = {}
    looked = list(looked)
    for k, picture in _pictures(clips, looked, poses):
        pose = poses[k]
        try:
            seen[k] = sights(
                picture.pixels, table, camera, pose, setup.board, setup.balls, setup.mirrors,
                covered,
            )  # fmt: skip
            places[k] = places_in(picture.pixels, seen[k], camera, pose, setup)
        except InputError:
            seen.pop(k, None)
            looked[k] = looked[k].because("a place on the board lies behind the camera")
            continue
        looked[k] = looked[k].because(places[k].refused)
        all_srgb = all_srgb and picture.is_srgb
    return looked, seen, places, all_srgb


def _on_board(
    lamps: Sequence[FoundLamp], groups: Sequence[int], poses: Sequence[Pose], setup: HandheldSetup
) -> list[Floats]:
    """The lamp of each picture, on the board."""
    if not setup.lamp_on_camera:
        return [lamps[group].at_m for group in groups]
    return [
        pose.rotation.T @ (lamps[group].at_m - pose.translation_m)
        for group, pose in zip(groups, poses, strict=True)
    ]


def _lit_by(setup: HandheldSetup, clips: Sequence[int]) -> list[int | None]:
    """The clips that have a lamp each; None: one lamp is on the camera in all."""
    return [None] if setup.lamp_on_camera else list(sorted(set(clips)))


def _lamps(
    looked: Sequence[Judged],
    poses: dict[int, Pose],
    seen: dict[int, Sights],
    lit: Sequence[int | None],
    camera: Camera,
    setup: HandheldSetup,
    table: Floats32,
    clips: Sequence[Clip],
) -> list[FoundLamp]:
    """One of each in `lit`, by all its sharp pictures."""
    said = None if setup.flash_m is None else setup.flash_m * Y_UP
    setting = LampSetting(
        camera, setup.board, setup.balls, setup.mirrors, setup.shadows, setup.lamp_on_camera,
        setup.middle_m, said,
    )  # fmt: skip
    found = []
    for clip in lit:
        rows = [k for k in seen if clip is None or looked[k].clip == clip]
        name = clips[clip or 0].name
        own = [poses[k] for k in rows], [seen[k] for k in rows]
        found.append(find_lamp(setting, *own, table, name))
    return found


def _covered(setup: HandheldSetup) -> NDArray[np.bool_]:
    """`[S]` white squares of the board on which piece, white, mirror, grey or ball lies, or seems
    to, seen at a slant."""
    import cv2

    points = white_squares_m(setup.board)
    covered = np.zeros(len(points), bool)
    regions = [setup.region_m[:, :2], setup.white_m, *(m.corners_m for m in setup.mirrors)]
    for region in regions:
        outline = np.asarray(region, np.float32).reshape(-1, 1, 2)
        inside = [
            max(cv2.pointPolygonTest(outline, (float(x), float(y)), True) for x, y in square)
            > -0.25 * setup.board.square_m
            for square in points
        ]
        covered |= np.array(inside)
    middles = points.mean(axis=1)
    for ball in setup.balls:
        covered |= np.hypot(*(middles - [ball.x_m, ball.y_m]).T) < 4 * ball.radius_m
    for grey in setup.greys:
        covered |= np.hypot(*(middles - [grey.x_m, grey.y_m]).T) < setup.board.square_m
    return covered


def _srgb() -> Floats32:
    return SRGB_SPACE.table(255)[:, 0]


def _turned(clips: Sequence[Clip], looked: Sequence[Judged]) -> list[str]:
    other = [each.name for each in looked if each.other_way]
    if not other:
        return []
    which = other[0] if len(other) == 1 else f"{other[0]} … ({len(other)} pictures)"
    return [
        f"{which}: the file says another orientation than the first's or the camera file's; all "
        f"are read as one sensor has them, turned by EXIF's orientation {clips[0].orientation}"
    ]


def _without_pictures(
    clips: Sequence[Clip], looked: Sequence[Judged], chosen: Sequence[int]
) -> list[str]:
    """A note for each clip of which nothing is kept."""
    notes = []
    for place, clip in enumerate(clips):
        if any(looked[k].clip == place for k in chosen):
            continue
        most = reasons(each for each in looked if each.clip == place)
        why = most[0][0] if most else "others show as much"
        notes.append(f"{clip.name}: no picture of it is kept ({why})")
    return notes


def _said(
    lamps: Sequence[FoundLamp],
    lit: Sequence[int | None],
    exposures: Floats,
    setup: HandheldSetup,
    clips: Sequence[Clip],
) -> list[str]:
    notes = []
    for k, lamp in enumerate(lamps):
        clip = lit[k]
        which = "the lamp: " if clip is None else f"{clips[clip].name}: the lamp: "
        if lamp.std_deg > 1.0:
            notes.append(
                f"{which}its direction is known to {lamp.std_deg:.1f} deg only; another ball or a "
                "mirror, or more pictures, would help"
            )
        if lamp.level_rms > 0.1:
            notes.append(
                f"{which}the light on the board's white squares differs by "
                f"{100 * lamp.level_rms:.0f} % from what it would give: other lights in the room, "
                "or a tone curve that is not the camera's"
            )
        if lamp.vignetting > 0.1:
            notes.append(
                f"{which}the picture's corners are {100 * lamp.vignetting:.0f} % darker than its "
                "middle; a flat field takes that away"
            )
    spread = float(np.ptp(exposures[:, 1]))
    if setup.locked and spread > 0.1:
        notes.append(
            f"the exposure is said to be locked, but the white differs by {100 * spread:.0f} % "
            "between pictures"
        )
    if setup.lamp_on_camera:
        notes.append(
            "a lamp on the camera shows light and view side by side only: a small part of the "
            "hemisphere; a lamp that stands beside the board shows the rest"
        )
    return notes
