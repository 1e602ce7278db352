"""Tensor files: written, read, and damaged."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.exchange import tensor_fields
from raden_torch.capture.exchange.tensor_fields import TYPES, read_fields, write_fields
from raden_torch.errors import InputError


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "some.bsdf"
    write_fields(path, {"text": np.arange(5, dtype=np.uint8), "a": np.ones((2, 3), "<f4")})
    return path


def test_every_type_comes_back_from_an_aligned_place(tmp_path: Path) -> None:
    draw = np.random.default_rng(0)
    fields = {f"f{i}": draw.integers(0, 99, (i, 3)).astype(t) for i, t in enumerate(TYPES) if t}
    size = write_fields(tmp_path / "all.bsdf", fields)
    assert (tmp_path / "all.bsdf").stat().st_size == size
    found = read_fields(tmp_path / "all.bsdf")
    assert list(found) == list(fields)
    for name, wanted in fields.items():
        assert found[name].dtype == wanted.dtype
        np.testing.assert_array_equal(found[name], wanted)


def test_the_bytes_are_the_formats(file: Path) -> None:
    """Written out by hand from the readers' sources."""
    data = file.read_bytes()
    assert data[:18] == b"tensor_file\0\x01\x00" + struct.pack("<I", 2)
    name, sides, kind, start, side = struct.unpack_from("<4sHBQQ", data, 20)
    assert (name, sides, kind, side) == (b"text", 1, 1, 5)
    assert start % 8 == 0
    assert data[start : start + 5] == bytes(range(5))
    second = 20 + struct.calcsize("<4sHBQQ")
    length, name, sides, kind, start, *shape = struct.unpack_from("<HcHBQQQ", data, second)
    assert (length, name, sides, kind, shape) == (1, b"a", 2, 10, [2, 3])
    assert struct.unpack_from("<6f", data, start) == (1.0,) * 6


def test_a_file_cut_anywhere_is_refused(file: Path) -> None:
    data = file.read_bytes()
    for length in range(len(data)):
        file.write_bytes(data[:length])
        with pytest.raises(InputError, match=r"some\.bsdf: .*expected") as caught:
            read_fields(file)
        assert "\n" not in str(caught.value)


def changed(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at + len(new) :]


@pytest.mark.parametrize(
    ("at", "new", "message"),
    [
        (0, b"Tensor_file", "begins with 'tensor_file'"),
        (12, b"\x02", r"version 1\.0, got version 2\.0"),
        (14, struct.pack(">I", 2), "expected little-endian"),
        (14, struct.pack("<I", 10**9), "fields: expected at most 64, got 1000000000"),
        (26, b"\x0c", "field 'text': expected a type and a shape"),
        (26, b"\x00", "field 'text': expected a type and a shape"),
        (35, struct.pack("<Q", 4096**3), r"expected 68719476736 numbers, got a file of"),
        (35, struct.pack("<Q", 2**63), r"expected 9223372036854775808 numbers, got a file of"),
        (27, struct.pack("<Q", 2**62), "it is truncated"),
    ],
)
def test_damage_is_refused_in_a_line(file: Path, at: int, new: bytes, message: str) -> None:
    file.write_bytes(changed(file.read_bytes(), at, new))
    with pytest.raises(InputError, match=message):
        read_fields(file)


def test_too_much_is_refused_before_it_is_read_or_written(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tensor_fields, "MOST_BYTES", 100)
    with pytest.raises(InputError, match="expected at most 100 bytes"):
        read_fields(file)
    with pytest.raises(InputError, match="expected at most 100 bytes"):
        write_fields(tmp_path / "large.bsdf", {"a": np.zeros(100, np.uint8)})
    assert not (tmp_path / "large.bsdf").exists()
    with pytest.raises(InputError, match=r"absent\.bsdf: expected a tensor file"):
        read_fields(tmp_path / "absent.bsdf")
