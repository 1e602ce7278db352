"""--json: what a command reports as one JSON object on stdout."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

AsJson = Annotated[bool, Parameter(name="--json", help="print JSON instead of text")]
"""The option of every command that reports."""


def print_json(**report: Any) -> None:
    """Print an object of these keys; see `plain` for what values become."""
    print(json.dumps(plain(report), indent=2, allow_nan=False))


def plain(value: Any) -> Any:
    """JSON values: dataclasses are objects, without their arrays; NaN and infinity are null."""
    if is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items() if not hasattr(v, "__array__")}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value
