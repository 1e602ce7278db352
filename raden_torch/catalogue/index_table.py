"""Rows of the index, in memory and as Parquet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from raden_torch.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa


def read_parquet(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The rows of a file, or some of their columns.

    Raises:
        InputError: it is damaged.
        FileNotFoundError: it is not there.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with path.open("rb") as file:
        try:
            rows = pq.ParquetFile(file, page_checksum_verification=True)
            wanted = None if columns is None else list(columns)
            return rows.read(columns=wanted, use_threads=False)
        except (pa.ArrowException, OSError, ValueError, KeyError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(
                f"{path}: expected an index file, got a damaged one ({reason}); restore it from a "
                "copy"
            ) from None


def as_parquet(table: pa.Table) -> bytes:
    """A file's bytes, with checksums of its pages."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
    return bytes(sink.getvalue().to_pybytes())


def single_row(values: dict[str, Any]) -> pa.Table:
    """A shell's row; an array `[…]` becomes a list of that fixed length."""
    import numpy as np
    import pyarrow as pa

    columns: dict[str, pa.Array] = {}
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            flat = pa.array(value.ravel())
            columns[name] = pa.FixedSizeListArray.from_arrays(flat, value.size)
        elif isinstance(value, list):
            columns[name] = pa.array([value], pa.list_(pa.string()))
        else:
            columns[name] = pa.array([value])
    return pa.table(columns)
