"""What a step of `raden capture` found, as a small JSON file that a person and the next step read.

```
{
  "format": "raden capture",
  "version": 1,
  "kind": "camera",
  "made_from": ["board1.jpg", "board2.jpg"],
  … the kind's own keys, with units in their names
}
```
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from raden_torch.errors import InputError
from raden_torch.files import written_beside
from raden_torch.schema import checked, read_document

T = TypeVar("T")

FORMAT = "raden capture"
VERSION = 1


def write_result(
    path: str | os.PathLike[str],
    kind: str,
    content: Mapping[str, Any],
    *,
    made_from: Collection[str | os.PathLike[str]] = (),
) -> None:
    """Write a result.

    Args:
        kind: "camera", "colour", …: what `read_result` asks for.
        content: JSON values; NumPy arrays and numbers become lists and numbers.
        made_from: the files it was made from; only their names are kept.

    Raises:
        InputError: a suffix other than .json, a folder that does not exist.
    """
    check_result_path(path)
    head = {
        "format": FORMAT,
        "version": VERSION,
        "kind": kind,
        "made_from": [Path(source).name for source in made_from],
    }
    text = json.dumps(
        head | dict(content), indent=2, default=_plain, ensure_ascii=False, allow_nan=False
    )
    # a row of numbers in one line
    text = re.sub(r"\[\s+([^\[\]{}\"]*?)\s+\]", _in_one_line, text)
    with written_beside(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_result(path: str | os.PathLike[str], kind: str, schema: type[T]) -> T:
    """Read a result of one kind.

    Args:
        schema: a msgspec struct: what the reader needs of the file. Other keys are passed over.

    Raises:
        InputError: missing, not such a file, of another kind or version, or not as the schema asks.
    """
    what = f"a {kind} file of `raden capture`"
    found = read_document(path, what)
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise InputError(f"{path}: expected {what}, got another file")
    if found.get("version") != VERSION:
        raise InputError(f"{path}: expected version {VERSION}, got {found.get('version')!r:.80}")
    if (other := found.get("kind")) != kind:
        shown = other if isinstance(other, str) and other.isprintable() else repr(other)
        raise InputError(f"{path}: expected a {kind} file, got a {shown:.40} file")
    return checked(found, schema, str(path))


def check_result_path(path: str | os.PathLike[str]) -> None:
    """Raise InputError where a result could not be written, before the work is done."""
    from raden_torch.files import check_writable

    if Path(path).suffix.lower() != ".json":
        raise InputError(
            f"{path}: expected a file name that ends in .json, got {Path(path).suffix or '(none)'}"
        )
    check_writable(path)


def _in_one_line(numbers: re.Match[str]) -> str:
    return "[" + re.sub(r",\s+", ", ", numbers[1]) + "]"


def _plain(value: object) -> Any:
    if isinstance(value, np.ndarray):
        return [None if isinstance(v, float) and not np.isfinite(v) else v for v in value.tolist()]
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no place in a result file")
