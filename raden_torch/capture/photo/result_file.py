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
import reprlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from raden_torch.errors import InputError
from raden_torch.files import written_beside

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


def read_result(path: str | os.PathLike[str], kind: str, keys: Collection[str]) -> dict[str, Any]:
    """Read a result of one kind, with at least these keys.

    Raises:
        InputError: missing, not such a file, of another kind or a newer version, or a key missing.
    """
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(
            f"{path}: expected a {kind} file of `raden capture`, got an error: {error.strerror}"
        ) from None
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: expected a {kind} file of `raden capture`, got a file that is not JSON "
            f"({error})"
        ) from None
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise InputError(f"{path}: expected a {kind} file of `raden capture`, got another file")
    if found.get("version") != VERSION:
        raise InputError(f"{path}: expected version {VERSION}, got {found.get('version')}")
    if found.get("kind") != kind:
        raise InputError(f"{path}: expected a {kind} file, got a {found.get('kind')} file")
    missing = [key for key in keys if key not in found]
    if missing:
        raise InputError(
            f"{path}: expected a whole {kind} file, got one without {', '.join(missing)}"
        )
    return found


def numbers(
    path: str | os.PathLike[str], found: Mapping[str, Any], key: str, shape: tuple[int, ...]
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """An array of a result, checked; −1 in `shape` stands for any length.

    Raises:
        InputError: other than finite numbers of that shape.
    """
    try:
        array = np.asarray(found.get(key), np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.full(0, np.nan)
    fits = array.ndim == len(shape) and all(
        n in (-1, have) for n, have in zip(shape, array.shape, strict=True)
    )
    if not (fits and np.isfinite(array).all()):
        wanted = " x ".join("n" if n < 0 else str(n) for n in shape) or "one"
        raise InputError(
            f"{path}: {key}: expected {wanted} finite numbers, got {reprlib.repr(found.get(key))}"
        )
    return array


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
