"""The Japanese README says what the English one does: the same code, tables and links, in order."""

from __future__ import annotations

import re
from pathlib import Path

PROJECT = Path(__file__).parents[2]
ENGLISH, JAPANESE = ((PROJECT / name).read_text("utf-8") for name in ("README.md", "README.ja.md"))


def outline(text: str) -> list[str]:
    """Headings by their level, and tables by their rows."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    return re.findall(r"^(#+) |^(\|)", text, flags=re.MULTILINE)


def test_the_code_is_the_same() -> None:
    blocks = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
    assert len(blocks.findall(ENGLISH)) == 5
    assert blocks.findall(JAPANESE) == blocks.findall(ENGLISH)


def test_the_sections_and_tables_are_the_same() -> None:
    assert len(outline(ENGLISH)) > 15
    assert outline(JAPANESE) == outline(ENGLISH)


def test_the_links_are_the_same() -> None:
    link = re.compile(r"\]\(([^)]+)\)")
    english, japanese = (set(link.findall(text)) for text in (ENGLISH, JAPANESE))
    assert english - {"README.ja.md"} == japanese - {"README.md"}


def test_the_numbers_are_the_same() -> None:
    """Rationale: a figure that is measured anew has to change in both."""
    number = re.compile(r"\d+\.\d+")
    assert sorted(number.findall(JAPANESE)) == sorted(number.findall(ENGLISH))
