"""A set of photographs and its mask: what is read, what is refused before it is solved."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from raden_torch.brdf.files.image_file import read_mask as read_relighting_mask
from raden_torch.capture.photo.photo_set import check_exposure, read_mask, read_set
from raden_torch.errors import InputError

DISC = np.hypot(*(np.mgrid[:40, :60] - np.array([20, 30])[:, None, None])) < 15


@pytest.mark.parametrize(
    "stored",
    [
        DISC.astype(np.uint8) * 255,
        DISC.astype(np.uint8),
        DISC.astype(np.uint16) * 65535,
        DISC.astype(np.float32),
        np.stack([DISC * 0, DISC * 0, DISC * 255], -1).astype(np.uint8),
        np.stack([DISC * 0, DISC * 90, DISC * 0, DISC * 255], -1).astype(np.uint8),
    ],
    ids=["255", "1", "65535", "float", "red", "alpha"],
)
def test_masks_as_programs_write_them(tmp_path: Path, stored: np.ndarray) -> None:
    path = tmp_path / ("m.tiff" if stored.dtype == np.float32 else "m.png")
    cv2.imwrite(str(path), stored)
    assert ((read_mask(path, DISC.shape) == 1) == DISC).all()
    assert ((read_relighting_mask(path)[0, 0] == 1).numpy() == DISC).all()


def test_masks_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "m.png"
    cv2.imwrite(str(path), np.zeros((40, 60), np.uint8))
    with pytest.raises(
        InputError, match=r"m\.png: expected a mask that is white on the object, got an empty one"
    ):
        read_mask(path, (40, 60))
    cv2.imwrite(str(path), np.full((40, 60), 90, np.uint8))
    with pytest.raises(
        InputError, match=r"m\.png: expected .*, got one that is nowhere above half"
    ):
        read_mask(path, (40, 60))
    with pytest.raises(
        InputError, match=r"m\.png: expected a mask of 40 x 60 pixels, .*, got 60 x 40"
    ):
        read_mask(path, (60, 40))


def test_one_depth_in_a_set(tmp_path: Path) -> None:
    deep = np.full((40, 60, 3), 20000, np.uint16) + np.arange(60, dtype=np.uint16)[:, None]
    cv2.imwrite(str(tmp_path / "0.png"), deep)
    cv2.imwrite(str(tmp_path / "1.png"), (deep >> 8).astype(np.uint8))
    with pytest.raises(
        InputError,
        match=r"1\.png: expected photographs saved alike, got 8 bits a value, but .*0\.png has 16",
    ):
        read_set([tmp_path / "0.png", tmp_path / "1.png"])


def test_a_photograph_that_is_clipped_all_over(tmp_path: Path) -> None:
    paths = [tmp_path / f"{k}.png" for k in range(5)]
    for k, path in enumerate(paths):
        cv2.imwrite(str(path), np.full((40, 60, 3), 255 if k == 3 else 90, np.uint8))
    with pytest.raises(InputError, match=r"3\.png: over-exposed: 100 % of the object"):
        check_exposure(read_set(paths), torch.ones(1, 1, 40, 60))
