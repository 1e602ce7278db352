"""What a picture without a board lacks, told by what the other pictures show."""

from __future__ import annotations

import re


def where_others_show_it(message: str) -> str:
    """A message of `find_board`, where other pictures show that the board is the right one."""
    if "over-exposed" in message:
        return message
    likely = (
        "other pictures show the board; here it is too blurred or too dark to be made out, or too "
        "little of it is in the picture"
    )
    return re.sub(r"expected a \d+ x \d+ board .*", likely, message)
