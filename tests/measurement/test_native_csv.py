"""The project's CSV: an exact round trip, and one line for everything that can be wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import raden_torch as rt
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.reading_checks import _MISSING

HEADER = "incidence_deg,receiving_deg,tilt_deg,X,Y,Z\n"
ROWS = "0,-70,-70,19.5,20.1,19.1\n0,-70,-65,18.5,19.2,18.3\n5,10,0,7,8,9\n"


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "m.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def test_reads_the_shared_format(tmp_path: Path) -> None:
    text = (
        "# material: pearl\n# quantity: XYZ reflectance factor, perfect reflecting diffuser Y = "
        "100 in every geometry; CIE 1931 2 deg, D50\n# instrument: DDS-5000\n# a free note\n"
    )
    m = rt.load_measurement(write(tmp_path, text + HEADER + ROWS))
    assert m.metadata == Metadata("pearl", "DDS-5000", "D50", notes=("a free note",))
    assert m.incidence_deg.tolist() == [0, 0, 5]
    assert m.values[2].tolist() == [7, 8, 9]


# Hypothesis also draws constants that it finds in our code, codes for missing values among them
finite = st.floats(-1e6, 1e6, allow_nan=False, width=64).filter(lambda x: x not in _MISSING)


@settings(max_examples=50, deadline=None)
@given(data=st.data(), n=st.integers(1, 12))
def test_saving_and_loading_is_exact(tmp_path_factory, data, n: int) -> None:
    column = lambda low, high: hnp.arrays(float, n, elements=st.floats(low, high), unique=True)  # noqa: E731
    values = data.draw(hnp.arrays(float, (n, 3), elements=finite))
    gaps = data.draw(hnp.arrays(bool, n))
    values[gaps, 0] = np.nan
    m = BrdfMeasurement(
        data.draw(column(2, 90)),
        data.draw(column(-90, 90)),
        data.draw(column(-90, 90)),
        values,
        channels=data.draw(
            st.sampled_from([("X", "Y", "Z"), ("R", "G", "B"), ("1nm", "2.5nm", "3nm")])
        ),
        azimuth_deg=data.draw(st.none() | hnp.arrays(float, n, elements=st.floats(-180, 180))),
        std=data.draw(st.none() | hnp.arrays(float, (n, 3), elements=st.floats(0, 1e3))),
        count=data.draw(st.none() | hnp.arrays(np.int64, n, elements=st.integers(1, 10**9))),
        valid=data.draw(hnp.arrays(bool, n)),
        metadata=Metadata(
            sample=data.draw(st.sampled_from(["", "yakogai 夜光貝", "a: b, c"])),
            simulated=data.draw(st.booleans()),
            other=data.draw(st.sampled_from([(), (("lamp", "xenon: 150 W"),)])),
            notes=data.draw(st.sampled_from([(), ("two words", "more")])),
        ),
    )
    path = tmp_path_factory.mktemp("round") / "m.csv"
    m.save(path)
    assert rt.load_measurement(path) == m


def test_the_shared_files_round_trip(shared: Path, tmp_path: Path) -> None:
    m = rt.load_measurement(shared / "data/measured_brdf/pearl-paint.csv")
    assert len(m) == 12615
    assert m.grid().values.shape == (15, 29, 29, 3)
    m.save(tmp_path / "again.csv")
    assert rt.load_measurement(tmp_path / "again.csv") == m


def test_rows_in_any_order_and_gaps(tmp_path: Path) -> None:
    m = rt.load_measurement(write(tmp_path, HEADER + "5,0,0,1,2,3\n0,0,0,,,\n0,5,0,4,nan,6\n"))
    assert m.valid.tolist() == [True, False, False]
    assert m.grid().values.shape == (2, 2, 1, 3)


def test_windows_lines_and_byte_order_mark(tmp_path: Path) -> None:
    text = "\ufeff# material: x\r\n" + (HEADER + ROWS).replace("\n", "\r\n")
    assert len(rt.load_measurement(write(tmp_path, text))) == 3


BAD = {
    "missing column": (
        HEADER.replace("tilt_deg,", "") + ROWS,
        "expected columns of angles in degrees, got none named tilt_deg",
    ),
    "radians column": (
        HEADER.replace("_deg", "_rad") + ROWS,
        "got none named incidence_deg, receiving_deg",
    ),
    "radians given as degrees": (
        HEADER + "0,-1.2217,0,1,2,3\n0.0873,0.5,0,1,2,3\n",
        "look like radians",
    ),
    "duplicates that disagree": (HEADER + ROWS + "5,10,0,70,80,90\n", "readings 3 and 4"),
    "empty": ("", "empty"),
    "header only": (HEADER, "expected readings below its column names, got none"),
    "comments only": ("# material: x\n" * 3, "got text that begins with '# material: x'"),
    "cut within a row": (HEADER + ROWS[:-6], "line 4: expected 6 values, got 4; the file is trunc"),
    "cut between rows": (
        "# readings: 5\n" + HEADER + ROWS,
        "expected 5 readings by its header, got 3",
    ),
    "a header that claims 10 GB": (
        "# readings: 400000000\n" + HEADER + ROWS,
        "expected 400000000 readings by its header, got 63 characters",
    ),
    "a count that is none": ("# readings: many\n" + HEADER + ROWS, "'many'"),
    "infinite": (
        HEADER + ROWS + "9,9,9,1,inf,1\n",
        "reading 4: Y: expected a finite reflectance factor, got inf",
    ),
    "angle not a number": (
        HEADER + ROWS + "9,nan,9,1,1,1\n",
        "reading 4: receiving_deg: expected a finite number, got nan",
    ),
    "word": (HEADER + ROWS + "9,9,9,1,one,1\n", "line 5, column Y: expected a number, got 'one'"),
    "angle out of range": (
        HEADER + ROWS + "99,9,9,1,1,1\n",
        "reading 4: incidence_deg: expected 0…90 degrees, got 99",
    ),
    "not UTF-8": (
        (HEADER + ROWS).encode() + b"9,9,9,\xff,1,1\n",
        "line 5: expected UTF-8, or what is clearly Shift-JIS or Windows-1252, got byte 0xff",
    ),
    "binary": (b"\x00\x01\x02" * 100, "got a binary file that begins with the bytes 00 01 02"),
    "other scale": (
        "# quantity: reflectance, diffuser = 1\n" + HEADER + ROWS,
        "diffuser: expected 100, got 1;",
    ),
    "unknown channels": (HEADER.replace("X,Y,Z", "L,a,b") + ROWS, "L, a, b"),
    "a column twice": (HEADER.replace("Z", "Y") + ROWS, "twice"),
    "spread of one channel": (HEADER.strip() + ",std_X\n5,10,0,7,8,9,1\n", "std_X"),
    "valid neither 0 nor 1": (HEADER.strip() + ",valid\n5,10,0,7,8,9,2\n", "0 or 1"),
    "simulated perhaps": ("# simulated: perhaps\n" + HEADER + ROWS, "true or false"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line(name: str, tmp_path: Path) -> None:
    text, words = BAD[name]
    path = write(tmp_path, text)
    with pytest.raises(InputError) as error:
        rt.load_measurement(path)
    message = str(error.value)
    assert words in message
    assert str(path) in message
    assert "\n" not in message


def test_degrees_that_look_like_radians_can_say_so(tmp_path: Path) -> None:
    text = "# angles: degrees\n" + HEADER + "0,-1.2217,0,1,2,3\n0.0873,0.5,0,1,2,3\n"
    assert len(rt.load_measurement(write(tmp_path, text))) == 2


def test_missing_file_and_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(InputError, match="measurement file"):
            rt.load_measurement(path)


def test_too_large_a_file_is_refused_before_it_is_read(tmp_path: Path, monkeypatch) -> None:
    from raden_torch.measurement import native_csv

    monkeypatch.setattr(native_csv, "MAX_BYTES", 10)
    with pytest.raises(InputError, match="at most"):
        rt.load_measurement(write(tmp_path, HEADER + ROWS))


def test_a_failed_save_leaves_the_old_file(tmp_path: Path, monkeypatch) -> None:
    path = write(tmp_path, HEADER + ROWS)
    m = rt.load_measurement(path)
    from raden_torch.measurement import native_csv

    def full_disk(value: float) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(native_csv, "_number", full_disk)
    with pytest.raises(OSError, match="No space"):
        m.save(path)
    assert path.read_text() == HEADER + ROWS
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(InputError, match="expected an existing folder"):
        m.save(tmp_path / "none" / "m.csv")
