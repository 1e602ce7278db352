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
from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta, inspect

from raden_torch.errors import InputError

T = TypeVar("T")

_MOST = sys.float_info.max

Finite = Annotated[float, Meta(ge=-_MOST, le=_MOST)]
Positive = Annotated[float, Meta(gt=0, le=_MOST)]
NotNegative = Annotated[float, Meta(ge=0, le=_MOST)]
Count = Annotated[int, Meta(ge=0, le=2**53)]
Triple = tuple[Finite, Finite, Finite]
Matrix = tuple[Triple, Triple, Triple]
Text = Annotated[
    str,
    Meta(
        pattern=r"\A(?=.*\S)[^\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]+\Z", description="a text"
    ),
]
"""One line that is not blank."""

_MESSAGE = re.compile(r"(.*?)(?: - at (`key` in )?`\$([\w.\[\]]*)`)?", re.DOTALL)
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
        raise InputError(f"{path}: expected {what}, got an error: {error.strerror}") from None
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
    text, in_key, way = _MESSAGE.fullmatch(str(error)).groups("")  # type: ignore[union-attr]
    place, value, node = "", document, inspect.type_info(kind)
    for key, index in re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", way):
        if index == "...":
            key = _key_left_out(document, kind, value, str(error))
        node, value = _inside(node, key or int(index)), value[key or int(index)]
        place += f".{key}" if key else f"[{index}]"
    if isinstance(error.__cause__, InputError):  # what an object says of itself
        return place[1:], str(error.__cause__)
    key, got = "", _shown.repr(value)
    missing = re.match(r"Object missing required field `(.*)`", text)
    if missing:
        key = missing[1]
        expected = _words(_inside(node, key))
        near = get_close_matches(key, set(value) - set(_keys(node)), 1)
        got = "none" + (f"; is it {near[0]!r}?" if near else "")
    elif in_key or text.startswith("Object contains unknown field"):
        known = _keys(node)
        key = next(str(key) for key in value if key not in known)
        near = get_close_matches(key, known, 1)
        expected = f"one of {', '.join(sorted(known))}"
        got = _shown.repr(key) + (f"; did you mean {near[0]}?" if near else "")
    else:
        expected = _words(node)
    shown = key if key.isprintable() else repr(key)
    return f"{place}.{shown}"[1:].removesuffix("."), f"expected {expected}, got {got}"


def _key_left_out(document: Any, kind: Any, table: dict[str, Any], text: str) -> str:
    """The key that msgspec writes as [...]: alone in its table it is as wrong as before."""
    entries, found = dict(table), ""
    for found, entry in entries.items():
        table.clear()
        table[found] = entry
        try:
            msgspec.convert(document, kind)
        except msgspec.ValidationError as error:
            if str(error) == text:
                break
    table.update(entries)
    return found


def _inside(node: Any, key: str | int) -> Any:
    """The schema of an entry."""
    node = _container(node)
    if isinstance(node, inspect.DictType):
        return node.value_type
    if isinstance(key, int):
        return node.item_types[key] if isinstance(node, inspect.TupleType) else node.item_type
    return next(field.type for field in node.fields if field.encode_name == key)


def _container(node: Any) -> Any:
    """The only alternative of a union that has entries."""
    if isinstance(node, inspect.Metadata):
        return _container(node.type)
    if isinstance(node, inspect.UnionType):
        return next(kind for kind in map(_container, node.types) if _has_entries(kind))
    return node


def _has_entries(node: Any) -> bool:
    return any(hasattr(node, name) for name in ("fields", "item_type", "item_types", "value_type"))


def _keys(node: Any) -> list[str]:
    node = _container(node)
    if isinstance(node, inspect.DictType):
        return [str(key) for key in _choices(node.key_type)]
    return [field.encode_name for field in node.fields]


def _choices(node: Any) -> list[Any]:
    return [m.value for m in node.cls] if isinstance(node, inspect.EnumType) else list(node.values)


def _words(node: Any) -> str:
    """What a schema allows."""
    if isinstance(node, inspect.Metadata):
        return (node.extra_json_schema or {}).get("description") or _words(node.type)
    if isinstance(node, inspect.UnionType):
        kinds = [kind for kind in node.types if not isinstance(kind, inspect.NoneType)]
        return " or ".join(map(_words, kinds))
    if isinstance(node, (inspect.FloatType, inspect.IntType)):
        return f"a {_number(node)}"
    if isinstance(node, (inspect.EnumType, inspect.LiteralType)):
        return f"one of {', '.join(map(str, _choices(node)))}"
    if isinstance(node, inspect.TupleType):
        count, first = len(node.item_types), node.item_types[0]
        if isinstance(first, (inspect.FloatType, inspect.IntType)):
            return f"{count} {_number(first, 's')}"
        return f"{count} rows" + (f" of {_words(first)}" if hasattr(first, "item_types") else "")
    if isinstance(node, (inspect.ListType, inspect.VarTupleType)):
        least = f" of {node.min_length} or more" if node.min_length else ""
        return f"a list{least}"
    if hasattr(node, "fields"):
        return f"a table with {', '.join(_keys(node))}"
    return _NAMES.get(type(node), "a value")


_NAMES: dict[Any, str] = {
    inspect.StrType: "a text",
    inspect.BoolType: "true or false",
    inspect.DictType: "a table",
}


def _number(node: Any, plural: str = "") -> str:
    kind = ("whole " if isinstance(node, inspect.IntType) else "") + "number" + plural
    low, high = (None if bound in (-_MOST, _MOST) else bound for bound in (node.ge, node.le))
    if low is not None and high is not None:
        return f"{kind} in {low:g}…{high:g}"
    limits = (("above", node.gt), ("from", low), ("below", node.lt), ("up to", high))
    return " ".join([kind, *(f"{name} {limit:g}" for name, limit in limits if limit is not None)])
