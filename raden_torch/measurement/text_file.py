"""A text file in common encodings → text: gzip, byte order marks, Shift-JIS, Windows-1252.

UTF-8 is taken where the bytes are UTF-8, UTF-16 where a byte order mark says so. Anything else must
be Shift-JIS (Windows' cp932) or Windows-1252, and not both: `_legacy` has the rule. What separators
and numbers are made of is the same in all of them.
"""

from __future__ import annotations

import codecs
import gzip
import re
import zlib
from dataclasses import dataclass
from pathlib import Path

from raden_torch.errors import InputError, why
from raden_torch.files import check_seekable

HEAD_BYTES = 65_536
UTF_8 = "UTF-8"

_GZIP = b"\x1f\x8b\x08"
_MAX_EXPANSION = 60  # tables of numbers shrink to between a half and a twentieth
_CHUNK_BYTES = 1 << 20
_SMALL_BYTES = 50_000_000  # so much may come of any gzip file
_UTF_16 = {codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}

_OTHERS = {
    "a safetensors file, as models are": re.compile(rb".{8}\{", re.DOTALL),
    "a PNG image": re.compile(rb"\x89PNG"),
    "a JPEG image": re.compile(rb"\xff\xd8\xff"),
    "an OpenEXR image": re.compile(rb"\x76\x2f\x31\x01"),
    "a zip archive, as .pt and .xlsx files are": re.compile(rb"PK\x03\x04"),
}

_WESTERN = "À-ÖØ-öø-þ°±²³µ·×§«»©®¼½¾¿¡£¥€„…Š‹›ŒŽ‘’“”–—šœžŸ\u00a0"
_NOT_WESTERN = re.compile(rf"[^\x00-\x7f{_WESTERN}]|[^\x00-\x7f]{{3}}")
_MAYBE_JAPANESE = re.compile(r"[^\x00-\x7fÀ-ÖØ-öø-þ°±²³µ·§«»’]|[^\x00-\x7f]{2}")
_JAPANESE_LEAD = re.compile(rb"[\x81-\x9f]")  # without one it may be EUC-JP or GB 2312
_NOT_JAPANESE = re.compile("[\u0080-\u00a0\ue000-\uf8ff]")


@dataclass(frozen=True)
class TextFile:
    """A file's text, whose lines end with a line feed, and the encoding that it was taken for."""

    text: str
    encoding: str


def read_head(path: Path, wanted: str) -> bytes:
    """The first `HEAD_BYTES` of a file's content, unpacked where it is a gzip file.

    Raises:
        InputError: it cannot be opened; `wanted` says what should be there.
    """
    try:
        check_seekable(path)
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise InputError(f"{path}: expected {wanted}, got {why(error)}") from None
    return _unpacked(path, HEAD_BYTES) if head.startswith(_GZIP) else head


def head_text(head: bytes) -> str:
    """What the first bytes say, to recognise a format by; "" where they are not text."""
    encoding = _UTF_16.get(head[:2], "utf-8")
    text = codecs.getincrementaldecoder(encoding)("replace").decode(head).removeprefix("\ufeff")
    return "" if "\0" in text else _line_feeds(text)


def head_in_words(head: bytes) -> str:
    """What a file seems to be by its first bytes, for messages that expect another one."""
    if not head.strip():
        return "an empty file"
    for name, begins in _OTHERS.items():
        if begins.match(head):
            return name
    text = head[:40].decode("utf-8", "replace")
    if b"\0" in head or "\ufffd" in text[:-3]:
        return f"a binary file that begins with the bytes {head[:8].hex(' ')}"
    if re.match(r"\s*[{\[]", text):
        return "JSON of another program"
    return f"text that begins with {text.splitlines()[0]!r}"


def read_content(path: Path, limit: int) -> bytes:
    """A file's bytes, unpacked where it is a gzip file.

    Raises:
        InputError: more than `limit` bytes, packed or unpacked; a damaged gzip file, or one that
            unpacks to far more than a table can.
    """
    try:
        size = path.stat().st_size
        if size > limit:
            raise InputError(f"{path}: expected at most {_bytes(limit)}, got {size} bytes")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: expected a text file, got {why(error)}") from None
    if not data.startswith(_GZIP):
        return data
    most = min(limit, max(_SMALL_BYTES, _MAX_EXPANSION * size))
    unpacked = _unpacked(path, most + 1)
    if len(unpacked) > most:
        raise InputError(
            f"{path}: a gzip file of {_bytes(size)}; expected at most {_bytes(most)} in it, "
            "got more"
        )
    return unpacked


def read_text(path: Path, limit: int) -> TextFile:
    """A text file of at most `limit` bytes.

    Raises:
        InputError: what `read_content` refuses; bytes that are no text, or text in an encoding that
            cannot be told.
    """
    data = read_content(path, limit)
    utf_16 = _UTF_16.get(data[:2])
    try:
        found = TextFile(data.decode(utf_16 or "utf-8"), "UTF-16" if utf_16 else UTF_8)
    except UnicodeDecodeError as error:
        legacy = None if utf_16 else _legacy(data)
        if legacy is None:
            raise _undecodable(path, data, error, utf_16) from None
        found = legacy
    text = _line_feeds(found.text.removeprefix("\ufeff"))
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputError(f"{path}: line {line}: expected text, got a NUL character")
    return TextFile(text, found.encoding)


def shown(text: str) -> str:
    """A piece of a file, stripped, quoted and shortened, fit for a one-line message."""
    text = text.strip()
    return repr(text if len(text) <= 40 else f"{text[:37]}…")


def _line_feeds(text: str) -> str:
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _unpacked(path: Path, most: int) -> bytes:
    """The first bytes, at most so many, of what a gzip file holds in all its members."""
    parts, left = [], most
    try:
        with gzip.open(path) as file:
            while left and (part := file.read(min(left, _CHUNK_BYTES))):
                parts.append(part)
                left -= len(part)
    except EOFError:
        raise InputError(f"{path}: the gzip file is truncated; expected the whole file") from None
    except (zlib.error, gzip.BadGzipFile) as error:
        raise InputError(
            f"{path}: expected a whole gzip file, got a damaged one ({error})"
        ) from None
    return b"".join(parts)


def _legacy(data: bytes) -> TextFile | None:
    """Shift-JIS or Windows-1252, where the bytes can be but one of them.

    Windows-1252 must be what Western European text holds: signs from `_WESTERN`, no three in a
    row. Where the bytes are Shift-JIS as well, accented letters (or ° and the like) that stand
    alone between ASCII decide for Windows-1252, and everything else is ambiguous. Half-width
    katakana alone are, too: EUC-JP and GB 2312 look like them. Text that is mostly UTF-8 is
    damaged UTF-8.
    """
    replaced = data.decode("utf-8", "replace")
    broken = replaced.count("\ufffd")
    whole = len(replaced) - len(replaced.encode("ascii", "ignore")) - broken
    if whole > broken:
        return None
    japanese, western = _decoded(data, "cp932"), _decoded(data, "cp1252")
    if japanese is not None and _NOT_JAPANESE.search(japanese):
        japanese = None
    if western is not None and _NOT_WESTERN.search(western):
        western = None
    if western is not None and (japanese is None or not _MAYBE_JAPANESE.search(western)):
        return TextFile(western, "Windows-1252")
    if japanese is not None and western is None and _JAPANESE_LEAD.search(data):
        return TextFile(japanese, "Shift-JIS")
    return None


def _decoded(data: bytes, encoding: str) -> str | None:
    try:
        return data.decode(encoding)
    except UnicodeDecodeError:
        return None


def _undecodable(
    path: Path, data: bytes, error: UnicodeDecodeError, utf_16: str | None
) -> InputError:
    if utf_16:
        before = data[: error.start].decode(utf_16, "replace")
        line = _line_feeds(before).count("\n") + 1
        return InputError(
            f"{path}: line {line}: expected UTF-16, got {error.reason}; the file is damaged"
        )
    line = _line_feeds(data[: error.start].decode("latin-1")).count("\n") + 1
    return InputError(
        f"{path}: line {line}: expected UTF-8, or what is clearly Shift-JIS or Windows-1252, got "
        f"byte 0x{data[error.start]:02x}; save it as UTF-8"
    )


def _bytes(size: int) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.3g} MB"
