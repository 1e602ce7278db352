"""The board of several shells: that each is lit by its own models, and the light is broad."""

from __future__ import annotations

import pytest
import torch

import raden_torch as rt
from raden_torch.artwork.board import board_pieces, broad_light, shade_board
from raden_torch.errors import InputError


def flat_model(level: float) -> rt.RadenBrdf:
    """The same reflectance factor, in RGB, in every geometry."""
    axis = [-70.0, 0.0, 70.0]
    angles = [(a, r, t) for a in (0.0, 35.0, 70.0) for r in axis for t in axis]
    incidence, receiving, tilt = zip(*angles, strict=True)
    values = [[level, level, level]] * len(angles)
    return rt.fit(
        rt.BrdfMeasurement(incidence, receiving, tilt, values, channels=("R", "G", "B")),
        interpolation="trilinear",
    ).model


def test_every_shell_is_lit_by_its_own_models() -> None:
    dark, bright = flat_model(5.0), flat_model(80.0)
    with torch.no_grad():
        image = shade_board({"awabi": {1.0: dark}, "mexican": {0.9: bright, 1.1: bright}}, 160)
        blended = shade_board({"awabi": {1.0: dark}, "mexican": {1.0: bright}}, 160)
    assert image.shape == (1, 3, 115, 160)
    assert torch.isfinite(image).all()
    assert (image > 0).all()
    left, right = image[..., :80].mean(), image[..., 80:].mean()
    assert right > 2 * left
    torch.testing.assert_close(image, blended, rtol=1e-3, atol=1e-3)  # weights add up to 1


def test_light_is_above_and_broad() -> None:
    directions = torch.tensor([light.direction for light in broad_light()])
    assert (directions[:, 2] > 0).all()
    assert len(directions) >= 60


def test_pieces_stay_on_their_panels() -> None:
    for shells in (["akoya"], ["akoya", "awabi", "mexican"]):
        for piece in board_pieces(shells):
            panel = piece.x + len(shells) / 2
            assert shells[int(panel)] == piece.shell
            assert abs(piece.y) < 0.72


def test_a_shell_without_habit_is_refused() -> None:
    with pytest.raises(InputError, match="oyster"):
        shade_board({"oyster": {1.0: flat_model(10.0)}}, 40)
