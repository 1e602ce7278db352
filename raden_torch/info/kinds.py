"""Which kind of file is this? Found by its first bytes, never by its name."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from raden_torch.errors import InputError
from raden_torch.info import pictures, reflectance, results, rigs, shader
from raden_torch.measurement.text_file import read_head


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
        name: with its article, for messages.
        recognises: whether a file that begins with these bytes is one, or means to be.
        describe: what it holds, one fact a line; raises InputError where it is damaged.
    """

    name: str
    recognises: Callable[[bytes], bool]
    describe: Callable[[Path], str]


KINDS = (
    Kind("a model", lambda head: head[8:9] == b"{", reflectance.describe_model_file),
    Kind("an ONNX file", shader.recognises, shader.describe),
    Kind("an OpenEXR file", pictures.recognises_exr, pictures.describe_exr),
    Kind("an image", pictures.recognises_image, pictures.describe_image),
    Kind("a scan's journal", rigs.recognises_journal, rigs.describe_journal),
    Kind("a rig file", rigs.recognises_rig, rigs.describe_rig),
    Kind("a result of `raden capture`", results.recognises_result, results.describe_result),
    Kind("a calibration by OpenCV", results.recognises_opencv, results.describe_camera),
    Kind("the truth of simulated photographs", results.recognises_truth, results.describe_truth),
    Kind("a benchmark", results.recognises_bench, results.describe_bench),
    Kind("a list of cells", rigs.recognises_cells, rigs.describe_cells),
    Kind(
        "a measurement", reflectance.recognises_measurement, reflectance.describe_measurement_file
    ),
)
"""The first that recognises a file has it."""


def describe_file(path: str | os.PathLike[str]) -> str:
    """What a file holds, one fact a line.

    Raises:
        InputError: missing, empty, damaged, or of none of `KINDS`.
    """
    kind = kind_of(path)
    try:
        return kind.describe(Path(path))
    except InputError as error:
        named = str(path) in str(error)
        raise InputError(str(error) if named else f"{path}: {error}") from None
    except (
        *(AttributeError, IndexError, KeyError, TypeError, ValueError),
        *(OverflowError, RecursionError),
    ) as error:
        raise InputError(
            f"{path}: expected {kind.name} as raden writes it, got other content "
            f"({type(error).__name__}: {error})"
        ) from None


def kind_of(path: str | os.PathLike[str]) -> Kind:
    """The kind of a file, by its first bytes.

    Raises:
        InputError: missing, empty, or of none of `KINDS`.
    """
    head = read_head(Path(path), "a file that raden knows")
    for kind in KINDS:
        if kind.recognises(head):
            return kind
    known = ", ".join(kind.name for kind in KINDS)
    raise InputError(f"{path}: expected one of {known}; got {_in_words(head)}")


def _in_words(head: bytes) -> str:
    if not head.strip():
        return "an empty file"
    text = head[:40].decode("utf-8", "replace")
    if b"\0" in head or "\ufffd" in text[:-3]:
        return f"a binary file that begins with the bytes {head[:8].hex(' ')}"
    if re.match(r"\s*[{\[]", text):
        return "JSON of another program"
    return f"text that begins with {text.splitlines()[0]!r}"
