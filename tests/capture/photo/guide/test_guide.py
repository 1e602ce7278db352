"""The guide's stances can be set up, and tell more than others; its files; what it refuses."""

from __future__ import annotations

import csv
import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raden_torch as rt
from raden_torch.capture.photo.camera import Camera
from raden_torch.capture.photo.guide.choice import Knowledge, hemisphere_deg
from raden_torch.capture.photo.guide.piece import Piece
from raden_torch.capture.photo.guide.plan import plan_photographs
from raden_torch.capture.photo.guide.plan_file import read_plan
from raden_torch.capture.photo.guide.set_up import ABOVE_MM, BODY_MM, SetUp, stances
from raden_torch.capture.photo.guide.view import AROUND, NEAREST_MM, view_of
from raden_torch.errors import InputError
from raden_torch.plots.guide_figure import first_photograph
from raden_torch.reflectance.log_readings import LogReadings
from raden_torch.reflectance.symmetric_kriging import RECIPROCAL, Lengths, SymmetricKriging

Command = Callable[..., subprocess.CompletedProcess[str]]


@settings(deadline=None, max_examples=12)
@given(
    st.sampled_from(["hand", "turntable", "still"]),
    st.floats(200, 900),
    st.floats(150, 400),
    st.floats(0, 500),
    st.floats(30, 80),
)
def test_every_stance_can_be_set_up(
    kind: str, camera: float, nearest: float, more: float, lamp_to: float
) -> None:
    """Lamp above the table, within its reach and limit; neither stands in the other's rays; and the
    places in the piece's frame are those of the instruction, turned and leant with the piece."""
    how = SetUp(kind, camera, 30.0, (nearest, nearest + more), 50.0, lamp_to)
    for stance in stances(how, 40.0, most=60):
        lamp, eye = np.array(stance.lamp_mm), np.array(stance.camera_mm)
        assert nearest - 1 <= np.linalg.norm(lamp) <= nearest + more + 1
        assert np.linalg.norm(eye) == pytest.approx(camera, abs=0.1)
        assert lamp[2] >= np.linalg.norm(lamp) * np.cos(np.radians(lamp_to + 0.01))
        assert eye[2] >= np.linalg.norm(eye) * np.cos(np.radians(50.01))
        height = stance.lamp_distance_mm * np.cos(np.radians(stance.lamp_from_vertical_deg))
        assert height > ABOVE_MM
        between = lamp @ eye / np.linalg.norm(lamp) / np.linalg.norm(eye)
        near = min(np.linalg.norm(lamp), np.linalg.norm(eye))
        assert near * np.sqrt(max(1 - max(between, 0) ** 2, 0)) > BODY_MM
        normal = lean(stance.turn_deg, stance.wedge_deg) @ np.array([0.0, 0.0, 1.0])
        over = polar(stance.lamp_from_vertical_deg, stance.lamp_azimuth_deg)
        assert over @ normal == pytest.approx(lamp[2] / np.linalg.norm(lamp), abs=1e-4)


def lean(turn_deg: float, wedge_deg: float) -> np.ndarray:
    """The piece's axes over the table: leant with its x side down, then turned."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    d, e = np.cos(np.radians(wedge_deg)), np.sin(np.radians(wedge_deg))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ [[d, 0, e], [0, 1, 0], [-e, 0, d]]


def polar(angle_deg: float, azimuth_deg: float) -> np.ndarray:
    angle, azimuth = np.radians(angle_deg), np.radians(azimuth_deg)
    return np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth),
                     np.cos(angle)])  # fmt: skip


def test_a_mirror_s_stance_is_read_at_the_mirror() -> None:
    """A small piece, the camera opposite the lamp: incidence = receiving, no tilt."""
    small = Piece.flat(1.0, 1.0)
    angles = small.angles_deg(300 * polar(30, 180), 400 * polar(30, 0))
    np.testing.assert_allclose(angles, [[30, 30, 0]], atol=0.3)
    leant = Piece.flat(1.0, 1.0, (20.0,))
    angles = leant.angles_deg(300 * polar(30, 180), 400 * polar(30, 0))
    np.testing.assert_allclose(np.abs(angles), [[50, 10, 0]], atol=0.3)


def test_more_pieces_on_wedges_and_curved_ones_show_more() -> None:
    lamp, camera = 300 * polar(40, 90), 400 * polar(20, 0)
    flat = len(Piece.flat(30, 30).angles_deg(lamp, camera))
    assert len(Piece.flat(30, 30, (0, 20, 40)).angles_deg(lamp, camera)) > 2 * flat
    assert len(Piece.rod(60, 20).angles_deg(lamp, camera)) > 2 * flat
    assert len(Piece.button(20).angles_deg(lamp, camera)) > 4 * flat


def test_what_is_known_grows_as_kriging_says() -> None:
    """Photograph by photograph, the deviation is that of kriging all readings at once; a gain that
    is promised is the one that comes."""
    queries, read = hemisphere_deg(50, seed=1), hemisphere_deg(30, seed=2)
    lengths = Lengths(noise=1e-3)
    state = Knowledge(lengths, RECIPROCAL, queries, read, most=len(read))
    for part in np.split(read, 3):
        promised, before = state.gain(part), state.std.mean()
        state.add(part)
        assert before - state.std.mean() == pytest.approx(promised, abs=1e-9)
    values = np.exp(np.random.default_rng(0).normal(size=(30, 3)))
    whole = SymmetricKriging.of(LogReadings.of(read, values), RECIPROCAL, lengths)
    # ordinary kriging does not know the mean, and is a little less sure
    ratio = whole.std(queries) / np.sqrt(whole.variance) / state.std
    assert ((ratio > 0.999) & (ratio < 1.5)).all()


def test_a_plan_tells_more_than_chance_and_counts_what_was_measured() -> None:
    piece, how = Piece.flat(60, 48), SetUp()
    plan = plan_photographs(piece, how, 12, assume=RECIPROCAL)
    assert (np.diff(plan.expected) < 0).all()
    state = Knowledge(Lengths(), RECIPROCAL, hemisphere_deg(), np.zeros((0, 3)), most=2000)
    for stance in stances(how, piece.reach_mm)[::200][:12]:
        state.add(piece.angles_deg(np.array(stance.lamp_mm), np.array(stance.camera_mm)))
    assert np.expm1(0.35 * np.median(state.std)) > 1.3 * plan.expected[-1]
    angles = np.concatenate(plan.readings[:6])
    measured = rt.simulate_specimen("yakogai", geometries_deg=angles, noise=0.01)
    more = plan_photographs(piece, how, 4, assume=RECIPROCAL, measured=measured)
    assert len(more.known) == len(angles)
    assert more.expected[0] < 0.4
    filled = first_photograph(more)
    assert (filled == 0).sum() >= len(np.unique(np.rint(angles / 5), axis=0))
    assert filled.max() == 4


def test_the_command_writes_what_it_prints(raden: Command, tmp_path: Path) -> None:
    files = [tmp_path / f"plan.{suffix}" for suffix in ("json", "csv", "png")]
    done = raden(
        *("capture", "guide", "--size", "60x48", "--count", 5, "--name", "lid"),
        *("--assume", RECIPROCAL, "--json", *[w for f in files for w in ("-o", f)]),
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert len(said["instructions"]) == len(said["photographs"]) == 5
    assert "deg from the vertical" in said["instructions"][0]
    kept = read_plan(files[0])
    assert kept.sample == "lid"
    assert kept.photographs[2].lamp_mm == tuple(said["photographs"][2]["lamp_mm"])
    rows = list(csv.DictReader(files[1].read_text().splitlines()))
    assert [row["photograph"] for row in rows] == ["1", "2", "3", "4", "5"]
    assert float(rows[-1]["expected_error_percent"]) < float(rows[0]["expected_error_percent"])
    assert min(cv2.imread(str(files[2])).shape[:2]) > 600
    table = raden("capture", "guide", "--set-up", "turntable", "--count", 2)
    assert "table turned" in table.stdout
    assert "wedge" in table.stdout


@settings(deadline=None, max_examples=30)
@given(
    st.sampled_from([Piece.flat(100, 80), Piece.flat(30, 10), Piece.rod(60, 20), Piece.button(40)]),
    st.floats(300, 3000),
    st.floats(-150, 150),
    st.floats(0, 85),
    st.floats(0, 360),
)
def test_what_a_camera_sees_from_its_distance(
    piece: Piece, focal: float, shift: float, away: float, turn: float
) -> None:
    """Wherever the camera stands, the ball that is said to be seen projects into its picture and
    touches its edge from one side; the piece's points lie in it."""
    matrix = np.array([[focal, 0, 479.5 + shift], [0, focal, 269.5], [0, 0, 1]])
    camera = Camera(matrix, np.zeros(5), (540, 960))
    view = view_of(piece, camera)
    assert view.seen_mm >= AROUND * view.reach_mm - 1e-6
    assert view.camera_mm == NEAREST_MM or view.seen_mm < (AROUND + 0.1) * view.reach_mm + 10
    way = polar(away, turn)
    x = np.cross(way, polar(away + 90, turn))
    axes = np.stack([x, np.cross(-way, x), -way])
    points = piece.points @ axes.T + [0, 0, view.camera_mm]
    pixels = (points @ matrix.T)[:, :2] / points[:, 2:]
    assert (pixels > -0.5).all()
    assert (pixels < [959.5, 539.5]).all()
    # the cone around the axis that touches the ball meets the nearest edge
    edge = np.tan(np.arcsin(view.seen_mm / view.camera_mm)) * focal
    middle = matrix[:2, 2] + 0.5
    assert edge == pytest.approx(min(*middle, *([960, 540] - middle)))


def test_the_distance_is_planned_for_a_camera(raden: Command, tmp_path: Path) -> None:
    content = {
        **{"format": "raden capture", "version": 1, "kind": "camera", "distortion": [0.0] * 5},
        **{"image_width_px": 960, "image_height_px": 540},
        "camera_matrix_px": [[770, 0, 479.5], [0, 770, 269.5], [0, 0, 1]],
    }
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps(content))
    words = ["capture", "guide", "--size", "100x80", "--count", 1, "--camera", camera]
    done = raden(*words, "--json", "-o", tmp_path / "plan.json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["view"]["camera_mm"] == said["set_up"]["camera_mm"] == 300.0
    assert said["view"]["reach_mm"] == pytest.approx(np.hypot(50, 40))
    place = read_plan(tmp_path / "plan.json").photographs[0].camera_mm
    assert np.linalg.norm(place) == pytest.approx(300, abs=0.1)
    farther = raden(*words, "--camera-distance", 385)
    assert "camera 38.5 cm away: 0.5 mm a pixel; 127 mm around the piece's" in farther.stdout
    nearer = raden(*words, "--camera-distance", 190)
    assert nearer.returncode == 2
    assert "distance: expected 194 mm or more, from which this camera sees" in nearer.stderr
    content["camera_matrix_px"][0][2] = -5
    camera.write_text(json.dumps(content))
    assert "expected its optical axis within the picture" in raden(*words).stderr


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["--shape", "plane", "--radius", 20], "a bent card is a cylinder"),
        (["--shape", "cylinder"], "--shape cylinder: expected --radius in mm, got none"),
        (["--set-up", "still"], "expected the camera or the piece moved"),
        (["--lamp-distance", "600:300"], "expected the least and the greatest"),
        (
            ["--lamp-to", 0, "--camera-to", 0],
            "expected limits that leave a place for lamp and camera, got none",
        ),
        (["--lamp-distance", "30"], "expected limits that leave a place"),
        (["--camera-to", 89], "expected 0 to 85 deg from the normal"),
        (["--count", 0], "expected 1 to 300 photographs, got 0"),
        (["--size", "0x10"], "expected above 0 and below 2000 mm, got 0 mm"),
        (["--size", "wide"], "expected width x height in mm, as 100x80, got wide"),
        (["--tilt", 70], "expected at most 60 deg, got 70 deg"),
        (["--tilt", 0, "--tilt", 30, "--set-up", "turntable"], "expected one piece"),
    ],
)
def test_what_cannot_be_planned_is_one_line(
    raden: Command, tmp_path: Path, words: list[object], wanted: str
) -> None:
    out = tmp_path / "plan.json"
    done = raden("capture", "guide", *words, "-o", out)
    assert done.returncode == 2, done.stdout
    assert wanted in done.stderr
    assert done.stderr.count("\n") == 1
    assert not out.exists()


def test_another_file_is_no_plan(tmp_path: Path) -> None:
    (tmp_path / "lights.json").write_text(
        '{"format": "raden capture", "version": 1, "kind": "lights"}'
    )
    with pytest.raises(InputError, match="expected a plan file, got a lights file"):
        read_plan(tmp_path / "lights.json")


def test_several_cards_are_a_row() -> None:
    """A row along either side fits in what is said to be seen, and what cuts it is refused."""
    matrix = np.array([[770.0, 0, 479.5], [0, 770, 269.5], [0, 0, 1]])
    camera = Camera(matrix, np.zeros(5), (540, 960))
    row = Piece.flat(100, 80, (0, 20, 40))
    for along, across in ((300, 80), (100, 240)):
        assert view_of(row, camera).reach_mm >= np.hypot(along, across) / 2 - 1e-9
    assert view_of(row, camera).reach_mm == pytest.approx(np.hypot(300, 80) / 2)
    with pytest.raises(InputError, match="distance: expected 470 mm or more"):
        view_of(row, camera, 300.0)
    assert view_of(Piece.flat(100, 80, (20,)), camera, 300.0).seen_mm > np.hypot(100, 80) / 2
