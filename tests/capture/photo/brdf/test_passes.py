"""Photographs stream through two passes: how many are in memory, what is seen, how far it is."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from raden_torch.capture.photo.brdf.photo_passes import photo_views
from raden_torch.capture.photo.brdf.photo_series import read_series
from raden_torch.capture.photo.brdf.seen_surface import fixed_surface, outline_std_px
from raden_torch.capture.photo.capture_brdf import capture_brdf
from raden_torch.capture.photo.development import Development
from raden_torch.errors import InputError


def test_two_photographs_at_most_are_in_memory(sphere: Any) -> None:
    """The one that is worked on, and the next while it is read."""
    series = sphere.series(6, radius=40.0)
    arguments = sphere.arguments(series)
    photos = read_series(arguments["photographs"], arguments["setup"])
    fixed = fixed_surface(photos, arguments["sample"])
    known: list[weakref.ref[Any]] = []
    numbers = []
    for view in photo_views(photos, arguments["sample"], fixed):
        known.append(weakref.ref(view.frame))
        gc.collect()
        assert sum(frame() is not None for frame in known) <= 2
        assert view.seen is fixed
        assert view.shot is photos.shots[view.number]
        numbers.append(view.number)
    assert numbers == list(range(6))
    assert outline_std_px(fixed, None) > 0


def test_a_sample_on_the_board_is_seen_anew_from_each_place(board: Any) -> None:
    series = board.series(board.lamps(3), [(0.0, 10.0), (60.0, 30.0), (200.0, 45.0)])
    arguments = board.arguments(series)
    photos = read_series(arguments["photographs"], arguments["setup"])
    sample = arguments["sample"]
    assert fixed_surface(photos, sample) is None
    middles = []
    for view in photo_views(photos, sample, None):
        pose = view.shot.pose
        assert pose is not None
        on_board = (
            view.seen.surface.point * [1, -1, -1] / 1000 - pose.translation_m
        ) @ pose.rotation
        np.testing.assert_allclose(on_board[:, 2], 0, atol=1e-9)
        middles.append(view.seen.middle)
    assert np.ptp(middles, axis=0).max() > 1
    assert outline_std_px(None, None) == 0


def test_progress_goes_from_one_photograph_to_the_next_twice(sphere: Any) -> None:
    series = sphere.series(8, radius=60.0)
    shares: list[float] = []
    capture_brdf(**sphere.arguments(series), progress=shares.append)
    assert shares == pytest.approx(np.arange(1, 17) / 16)


def test_exposure_times_for_some_photographs_only(sphere: Any) -> None:
    series = sphere.series(4, radius=40.0)
    arguments = sphere.arguments(series)
    exif = Image.Exif()
    exif.get_ifd(0x8769)[33434] = 0.5
    series.photos[2] = series.folder / "photo2.jpg"
    Image.fromarray(np.full((140, 220, 3), 90, np.uint8)).save(series.photos[2], exif=exif)
    arguments["setup"] = replace(arguments["setup"], development=Development())
    with pytest.raises(
        InputError, match=r"photo2\.jpg: an exposure time, but photo0\.png has none"
    ):
        capture_brdf(**arguments)
