"""What a file holds, in words: every kind of file that raden writes or reads."""

from raden_torch.info.kinds import KINDS, FileKind, describe_file, kind_of
from raden_torch.info.reflectance_info import describe_measurement, describe_model

__all__ = [
    "KINDS",
    "FileKind",
    "describe_file",
    "describe_measurement",
    "describe_model",
    "kind_of",
]
