"""Lines of G-code to the simulated controller: what they ask for, and how they are refused."""

from __future__ import annotations

import pytest

from raden_torch.capture.spectrometer.simulation.gcode_block import Block, Modes, read_block

FAST = Modes()
FEED = Modes(motion=1, feed=600.0)


@pytest.mark.parametrize(
    ("text", "modes", "block"),
    [
        ("G0A30B-.5", FAST, Block(FAST, {"A": 30.0, "B": -0.5}, None, None)),
        ("B2A1", FAST, Block(FAST, {"A": 1.0, "B": 2.0}, None, None)),
        ("G1X1F600", FAST, Block(FEED, {"X": 1.0}, None, None)),
        ("X1", FEED, Block(FEED, {"X": 1.0}, None, None)),
        ("G91", FEED, Block(Modes(1, 600.0, False), {}, None, None)),
        ("G90G0", Modes(1, 600.0, False), Block(Modes(0, 600.0), {}, None, None)),
        ("G4P0.25", FAST, Block(FAST, {}, 0.25, None)),
        ("G4", FAST, Block(FAST, {}, 0.0, None)),
        ("M8", FAST, Block(FAST, {}, None, True)),
        ("M9", FAST, Block(FAST, {}, None, False)),
        ("N10G21G54", FAST, Block(FAST, {}, None, None)),
    ],
)
def test_a_line_says_where_to_go_and_what_holds_from_then_on(
    text: str, modes: Modes, block: Block
) -> None:
    assert read_block(text, modes) == block


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("12", 1),
        ("G", 2),
        ("AB1", 2),
        ("G7", 20),
        ("M6", 20),
        ("G0.5", 20),
        ("Q1", 20),
        ("G1A10", 22),
        ("G1A10F0", 22),
        ("A1A2", 25),
    ],
)
def test_a_line_that_cannot_be_followed_gets_grblhals_number(text: str, number: int) -> None:
    assert read_block(text, FAST) == number
