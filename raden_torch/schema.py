"""JSON and TOML files of ours: read, checked against a schema, and what is wrong in one line.

A schema is a msgspec `Struct`, or a dataclass, whose types say what is allowed. A struct with
`forbid_unknown_fields` refuses other keys; `Meta(description=…)` says in words what a pattern asks.
"""

from __future__ import annotations

import json
import os
import re
import reprlib
import sys
from collections.abc import Callable, Collection
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from raden_torch.errors import InputError, why

T = TypeVar("T")

_MOST = sys.float_info.max
_MOST_COUNTED = 2**53

Finite = Annotated[float, Meta(ge=-_MOST, le=_MOST)]
Positive = Annotated[float, Meta(gt=0, le=_MOST)]
NotNegative = Annotated[float, Meta(ge=0, le=_MOST)]
Count = Annotated[int, Meta(ge=0, le=_MOST_COUNTED)]
Orientation = Annotated[int, Meta(ge=1, le=8)]
"""EXIF's."""
Triple = tuple[Finite, Finite, Finite]
Matrix = tuple[Triple, Triple, Triple]
Text = Annotated[
    str,
    Meta(
        pattern=r"\A(?=.*\S)[^\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]+\Z", description="a text"
    ),
]
"""One line that is not blank."""

_MESSAGE = re.compile(r"(.*?)(?: - at `\$([\w.\[\]]*)`)?", re.DOTALL)
_shown = reprlib.Repr()
_shown.maxstring = _shown.maxother = 80


def read_document(
    path: str | os.PathLike[str],
    what: str,
    parse: Callable[[str], Any] = json.loads,
    most_bytes: int = 100_000_000,
) -> Any:
    """What a JSON file holds, or a TOML file, with `tomllib.loads`.

    Args:
        what: the file should be, for messages: "a rig file".

    Raises:
        InputError: not there, too large, not UTF-8 text, not in that language.
    """
    path = Path(path)
    try:
        if (size := path.stat().st_size) > most_bytes:
            raise InputError(f"{path}: expected {what}, got over {most_bytes} bytes ({size})")
        return parse(path.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: expected {what}, got {why(error)}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected {what}, got bytes that are not UTF-8 text") from None
    except InputError:
        raise
    except (ValueError, RecursionError) as error:  # int() of 5,000 digits raises the former, too
        language = "JSON" if parse is json.loads else "TOML"
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{path}: expected {what}, got no valid {language}: {reason}") from None


def checked(document: Any, kind: type[T], where: str) -> T:
    """The document as a schema's object.

    Args:
        document: what a JSON or TOML reader gives.
        kind: the schema.
        where: the file, and the line where it has several documents: the message begins with it.

    Raises:
        InputError: "where: key[index].key: expected …, got …"; an unknown key comes with the
            nearest known one.
    """
    try:
        return msgspec.convert(document, kind)
    except msgspec.ValidationError as error:
        place, message = _explained(document, kind, error)
        raise InputError(": ".join(part for part in (where, place, message) if part)) from None
    except (RecursionError, UnicodeError) as error:  # lists in lists in lists; half a character
        raise InputError(f"{where}: expected another file, got one with {error}") from None


def _explained(document: Any, kind: Any, error: msgspec.ValidationError) -> tuple[str, str]:
    """The place, which may be empty, and what is wrong there."""
    text, way = _MESSAGE.fullmatch(str(error)).groups("")  # type: ignore[union-attr]
    unknown = text.startswith("Object contains unknown field")
    if unknown and not text.endswith("`"):
        way = ""  # was a part of its name
    way, unnamed, _ = way.partition("[...]")  # in a table of any keys: msgspec tells no more
    schema = msgspec.json.schema(kind)
    node, value, place = _Node(schema, schema.get("$defs", {})), document, ""
    for key, index in re.findall(r"\.(\w+)|\[(\d+)\]", way):
        node, value = node.entry(key or int(index)), value[key or int(index)]
        place += f".{key}" if key else f"[{index}]"
    if isinstance(error.__cause__, InputError):  # what an object says of itself
        return place[1:], str(error.__cause__)
    missing = re.fullmatch(r"Object missing required field `(.*)`", text)
    if missing and not unnamed:
        key, expected = missing[1], node.entry(missing[1]).words()
        near = get_close_matches(key, set(value) - set(node.names()), 1)
        got = "none" + (f"; is it {near[0]!r}?" if near else "")
    elif unknown and not unnamed:
        key = next(key for key in value if key not in node.names())
        expected = f"one of {', '.join(sorted(node.names()))}"
        got = _shown.repr(key) + nearest(key, node.names())
    else:
        key, expected, got = "", node.words(), _shown.repr(value)
    shown = key if key.isprintable() else repr(key)
    return f"{place}.{shown}"[1:].removesuffix("."), f"expected {expected}, got {got}"


def nearest(word: str, names: Collection[str]) -> str:
    """What comes after a word that is none of the names: a question, or nothing."""
    near = get_close_matches(word, names, 1)
    return f"; did you mean {near[0]}?" if near else ""


class _Node:
    """One place of a JSON schema, as msgspec makes it of types."""

    def __init__(self, content: dict[str, Any], definitions: dict[str, Any]) -> None:
        self._definitions = definitions
        while "$ref" in content:
            content = definitions[content["$ref"].rpartition("/")[2]]
        self._content = content
        self._others = [_Node(other, definitions) for other in content.get("anyOf", ())]

    def _holder(self) -> dict[str, Any]:
        """Of alternatives the one that has entries; there is one at most."""
        holders = (other._content for other in self._others)
        return next((c for c in holders if c["type"] in ("array", "object")), self._content)

    def entry(self, key: str | int) -> _Node:
        holder = self._holder()
        if isinstance(key, int):
            rows = holder.get("prefixItems")
            return _Node(rows[key] if rows else holder["items"], self._definitions)
        return _Node(holder["properties"][key], self._definitions)

    def names(self) -> list[str]:
        return list(self._holder().get("properties", ()))

    def words(self) -> str:
        """What is allowed."""
        content = self._content
        kind, rows = content.get("type", ""), content.get("prefixItems")
        if "description" in content and "title" not in content:  # else it is a docstring
            return str(content["description"])
        if self._others:
            words = (other.words() for other in self._others if other._content != {"type": "null"})
            return " or ".join(words)
        if "enum" in content:
            return f"one of {', '.join(map(str, content['enum']))}"
        if kind in ("number", "integer"):
            return f"a {_number(content)}"
        if rows:
            is_row = rows[0].get("type") == "array" and "prefixItems" in rows[0]
            each = f"rows of {self.entry(0).words()}" if is_row else "rows"
            return f"{len(rows)} {_number(rows[0], 's') if 'minimum' in rows[0] else each}"
        if "properties" in content:
            return f"a table with {', '.join(self.names())}"
        if isinstance(content.get("additionalProperties"), dict):
            entry = _Node(content["additionalProperties"], self._definitions)
            return f"a table, in which each entry is {entry.words()}"
        if content.get("minItems"):
            return f"a list of {content['minItems']} or more"
        return _WORDS.get(kind, "another value")


_WORDS = {
    "string": "a text",
    "boolean": "true or false",
    "array": "a list",
    "object": "a table",
}


def _number(content: dict[str, Any], plural: str = "") -> str:
    kind = ("whole " if content["type"] == "integer" else "") + "number" + plural
    low, high = content.get("minimum", -_MOST), content.get("maximum", _MOST)
    if low > -_MOST and high < _MOST:
        return f"{kind} in {low:g}…{high:g}"
    above = content.get("exclusiveMinimum")
    limit = f" above {above:g}" if above is not None else f" from {low:g}" if low > -_MOST else ""
    return kind + limit
