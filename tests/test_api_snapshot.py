"""The public names with their signatures are those of api.txt, which a person reads in a change.

`python tests/test_api_snapshot.py` renews the file. A parameter, method or attribute that is taken
away or renamed breaks users: CHANGELOG.md has a line for it.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from pathlib import Path

import torch

import raden_torch

SNAPSHOT = Path(__file__).with_name("api.txt")
_OTHERS = (torch.nn.Module, object)
"""What these have is not ours to keep."""


def described() -> str:
    """A paragraph for each public name: its signature, and a line for each public member."""
    return "\n".join(_of(name, getattr(raden_torch, name)) for name in raden_torch.__all__)


def _of(name: str, value: object) -> str:
    if not inspect.isclass(value):
        return f"{name}{_signature(value)}\n"
    lines = [f"class {name}{_signature(value)}"]
    if dataclasses.is_dataclass(value):
        lines += [f"    {field.name}: {field.type}" for field in dataclasses.fields(value)]
    for member in sorted(_own(value)):
        found = inspect.getattr_static(value, member)
        if isinstance(found, property):
            kind = "read and set" if found.fset else "read"
            lines.append(f"    {member}: {_returns(found)} ({kind})")
        elif callable(getattr(value, member)):
            lines.append(f"    {member}{_signature(getattr(value, member))}")
    return "\n".join(lines) + "\n"


def _own(kind: type) -> set[str]:
    """Public members that the class or a base of ours defines."""
    ours = (base for base in kind.__mro__ if base not in _OTHERS and "raden" in base.__module__)
    return {name for base in ours for name in vars(base) if not name.startswith("_")}


def _returns(found: property) -> str:
    return str(inspect.signature(found.fget).return_annotation) if found.fget else ""


def _signature(value: object) -> str:
    """Annotations as they are written; addresses in defaults would change from run to run."""
    return re.sub(r" at 0x[0-9a-f]+", "", str(inspect.signature(value)))


def test_the_public_signatures_are_those_of_the_file() -> None:
    found = described()
    assert found == SNAPSHOT.read_text("utf-8"), (
        "the public interface changed: if that is meant, say so in CHANGELOG.md and run "
        "python tests/test_api_snapshot.py"
    )


def test_a_change_is_seen() -> None:
    """Rationale: a snapshot that leaves parameters out would never fail."""
    text = described()
    for part in (
        "fit(measurement: 'BrdfMeasurement', *, diffuse:",
        "class GBuffer(",
        "    irradiance:",
        "-> 'FitResult'",
        "    save(self, ",
    ):
        assert part in text
    assert len(text.splitlines()) > 60
    assert "0x" not in text


if __name__ == "__main__":
    SNAPSHOT.write_text(described(), "utf-8")
