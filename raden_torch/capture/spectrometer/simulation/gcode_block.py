"""A line of G-code as the simulated controller understands it: its words, and what they ask for.

Refused lines get the number that grblHAL gives them: 1 where a word begins without a letter, 2 a
letter without a number, 20 a code or a letter that it does not know, 22 a feed move without a feed
rate, 25 a letter twice.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

LETTERS = "XYZABC"
"""Of the six axes, in their order."""

_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
_CODES = {
    "G": (0, 1, 4, 17, 18, 19, 20, 21, 40, 49, 53, 54, 61, 80, 90, 91, 93, 94),
    "M": (0, 1, 2, 3, 4, 5, 7, 8, 9, 30),
}
_OTHER_LETTERS = (*LETTERS, "F", "P", "S", "N")


@dataclass(frozen=True)
class Modes:
    """What holds from one line to the next.

    Attributes:
        motion: 0 as fast as the axes go (G0), 1 at the feed rate (G1).
        feed: units per minute; 0 before one was given.
        absolute: True for G90, False for G91.
    """

    motion: int = 0
    feed: float = 0.0
    absolute: bool = True


@dataclass(frozen=True)
class Block:
    """What a line asks for.

    Attributes:
        modes: from this line on.
        axes: the number behind each axis' letter that occurs.
        dwell_s: how long it waits (G4), or None; such a line does nothing else.
        shutter_closed: what coolant codes ask of the shutter (M8 closes it), or None.
    """

    modes: Modes
    axes: dict[str, float]
    dwell_s: float | None
    shutter_closed: bool | None


def read_block(text: str, modes: Modes) -> Block | int:
    """A line without spaces and comments, in capitals; the number of its error where refused."""
    words: list[tuple[str, float]] = []
    while text:
        match = _WORD.match(text)
        if match is None:
            return 2 if text[0].isalpha() else 1
        words.append((match[1], float(match[2])))
        text = text[match.end() :]
    for letter, number in words:
        known = number in _CODES[letter] if letter in _CODES else letter in _OTHER_LETTERS
        if not known:
            return 20
    plain = [letter for letter, _ in words if letter not in _CODES]
    if len(set(plain)) != len(plain):
        return 25
    values = dict(words)
    axes = {letter: values[letter] for letter in LETTERS if letter in values}
    motions = [int(n) for letter, n in words if letter == "G" and n in (0, 1)]
    distances = [n == 90 for letter, n in words if letter == "G" and n in (90, 91)]
    coolant = [n == 8 for letter, n in words if letter == "M" and n in (8, 9)]
    new = Modes(
        motions[-1] if motions else modes.motion,
        values.get("F", modes.feed),
        distances[-1] if distances else modes.absolute,
    )
    if axes and new.motion == 1 and new.feed <= 0:
        return 22
    dwell_s = values.get("P", 0.0) if ("G", 4.0) in words else None
    return Block(new, axes, dwell_s, coolant[-1] if coolant else None)
