"""The goniometer's real files, and a writer of tiny workbooks."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

GONIOMETER = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "goniometer_rt300s"

WriteWorkbook = Callable[[Path, Sequence[Sequence[str | float | None]]], Path]


@pytest.fixture(scope="session")
def goniometer() -> Path:
    if not GONIOMETER.is_dir():
        pytest.skip("the shared goniometer files are not here")
    return GONIOMETER


@pytest.fixture(scope="session")
def write_workbook() -> WriteWorkbook:
    """Write rows of cells as a one-sheet BIFF2 workbook ([MS-XLS]'s first ancestor)."""

    def record(kind: int, data: bytes) -> bytes:
        return struct.pack("<HH", kind, len(data)) + data

    def write(path: Path, rows: Sequence[Sequence[str | float | None]]) -> Path:
        out = record(0x09, struct.pack("<HH", 2, 0x10))
        for row, cells in enumerate(rows):
            for column, cell in enumerate(cells):
                place = struct.pack("<HH3x", row, column)
                if isinstance(cell, str):
                    text = cell.encode("ascii")
                    out += record(0x04, place + bytes([len(text)]) + text)
                elif cell is not None:
                    out += record(0x03, place + struct.pack("<d", cell))
        path.write_bytes(out + record(0x0A, b""))
        return path

    return write
