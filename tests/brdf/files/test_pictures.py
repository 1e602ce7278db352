"""Shapes, the display transform and picture files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from raden_torch.brdf.files.display import auto_exposure_ev, to_display, write_picture
from raden_torch.brdf.shading.sphere_gbuffer import average_samples, sphere
from raden_torch.errors import InputError


@pytest.mark.parametrize("camera", [(0.0, 0.0, 6.0), (3.0, -2.0, 4.0), (0.0, 5.0, 0.0)])
def test_sphere_lies_where_it_is_seen(camera: tuple[float, float, float]) -> None:
    gbuffer = sphere(64, camera, samples=1)
    hit = gbuffer.mask[0, 0] > 0
    assert 0.6 < hit.float().mean() < 0.72  # π/4 of the square, less the margin
    normal, position = gbuffer.normal[0][:, hit], gbuffer.position[0][:, hit]
    assert (normal.norm(dim=0) - 1).abs().max() < 1e-5
    assert torch.equal(normal, position)
    to_camera = torch.tensor(camera)[:, None] - position
    assert ((normal * to_camera).sum(0) > -1e-5).all()


def test_sphere_has_up_above_and_right_on_the_right() -> None:
    normal = sphere(32, samples=1).normal[0]
    assert normal[1, 4, 16] > 0.5 > -0.5 > normal[1, 27, 16]
    assert normal[0, 16, 27] > 0.5 > -0.5 > normal[0, 16, 4]


def test_wrong_spheres_are_refused() -> None:
    with pytest.raises(InputError, match="expected a position outside the unit sphere, got"):
        sphere(16, (0.1, 0, 0))
    with pytest.raises(InputError, match="16384 rays"):
        sphere(100_000)


def test_samples_are_averaged_in_linear_light() -> None:
    image = torch.tensor([[0.0, 1.0], [0.0, 0.0]]).expand(1, 3, 2, 2)
    assert average_samples(image, 2).flatten().tolist() == [0.25] * 3


def test_display_is_srgb() -> None:
    """IEC 61966-2-1: 0.5 linear is 0.735 encoded; what is out of range is clipped."""
    linear = torch.tensor([-1.0, 0.0, 0.001, 0.5, 1.0, 9.0]).view(1, 1, 1, 6).expand(1, 3, 1, 6)
    shown = to_display(linear)[0, 0, 0].tolist()
    assert shown == pytest.approx([0, 0, 0.01292, 0.7354, 1, 1], abs=1e-3)
    assert to_display(linear / 2, 1.0)[0, 0, 0].tolist() == pytest.approx(shown)


def test_auto_exposure_brings_highlights_to_white() -> None:
    image = torch.linspace(0, 8, 3000).view(1, 3, 1000, 1)
    assert 8 * 2 ** auto_exposure_ev(image) == pytest.approx(0.9, rel=0.02)
    assert auto_exposure_ev(torch.zeros(1, 3, 2, 2)) == 0


def test_picture_file(tmp_path: Path) -> None:
    picture = torch.zeros(3, 60, 200)
    picture[0] = 1.0
    write_picture(picture, tmp_path / "a.png")
    assert cv2.imread(str(tmp_path / "a.png"))[30, 30].tolist() == [0, 0, 255]
    write_picture(picture, tmp_path / "b.png", "simulated specimen")
    plain, labelled = (cv2.imread(str(tmp_path / f"{n}.png")) for n in "ab")
    assert (plain != labelled).any(axis=2)[40:].sum() > 100
    assert np.array_equal(plain[:30], labelled[:30])
    for wrong, words in (
        ("a.bmp", "suffix: expected one of .*, got .bmp"),
        ("none/a.png", "expected an existing folder"),
    ):
        with pytest.raises(InputError, match=words):
            write_picture(picture, tmp_path / wrong)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "b.png"]
