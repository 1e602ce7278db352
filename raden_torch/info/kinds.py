"""Which kind of file is this? Found by its first bytes, never by its name."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from raden_torch.errors import InputError
from raden_torch.info import image_info, reflectance_info, result_info, rig_info, shader_info
from raden_torch.measurement.text_file import head_in_words, read_head


@dataclass(frozen=True)
class FileKind:
    """A kind of file.

    Attributes:
        name: with its article, for messages.
        recognises: whether a file that begins with these bytes is one, or means to be.
        describe: what it holds, one fact a line; raises InputError where it is damaged.
    """

    name: str
    recognises: Callable[[bytes], bool]
    describe: Callable[[Path], str]


def _describe_model_file(path: Path) -> str:
    from raden_torch.info.material_info import describe_model_file  # with torch

    return describe_model_file(path)


KINDS = (
    FileKind("a model", lambda head: head[8:9] == b"{", _describe_model_file),
    FileKind("an ONNX file", shader_info.recognises, shader_info.describe),
    FileKind("an OpenEXR file", image_info.recognises_exr, image_info.describe_exr),
    FileKind("an image", image_info.recognises_image, image_info.describe_image),
    FileKind("a scan's journal", rig_info.recognises_journal, rig_info.describe_journal),
    FileKind("a rig file", rig_info.recognises_rig, rig_info.describe_rig),
    FileKind(
        "a result of `raden capture`", result_info.recognises_result, result_info.describe_result
    ),
    FileKind("a calibration by OpenCV", result_info.recognises_opencv, result_info.describe_camera),
    FileKind(
        "the truth of simulated photographs",
        result_info.recognises_truth,
        result_info.describe_truth,
    ),
    FileKind("a benchmark", result_info.recognises_bench, result_info.describe_bench),
    FileKind("a list of cells", rig_info.recognises_cells, rig_info.describe_cells),
    FileKind(
        "a measurement",
        reflectance_info.recognises_measurement,
        reflectance_info.describe_measurement_file,
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


def kind_of(path: str | os.PathLike[str]) -> FileKind:
    """The kind of a file, by its first bytes.

    Raises:
        InputError: missing, empty, or of none of `KINDS`.
    """
    head = read_head(Path(path), "a file that raden knows")
    for kind in KINDS:
        if kind.recognises(head):
            return kind
    known = ", ".join(kind.name for kind in KINDS)
    raise InputError(f"{path}: expected one of {known}; got {head_in_words(head)}")
