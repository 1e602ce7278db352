"""The project's CSV as spreadsheets save it: the same readings, and a word on what was assumed."""

from __future__ import annotations

import gzip
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import raden_torch as rt
from raden_torch.capture.spectrometer.ports import Position
from raden_torch.capture.spectrometer.scan_cells import list_cells
from raden_torch.capture.spectrometer.white_file import xyz_at
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.reading_checks import _MISSING

SHELL = {"euc_jp": "螺鈿", "gb2312": "螺钿贝壳", "big5": "螺鈿", "cp1251": "перламутр"}
JAPANESE, WESTERN = "夜光貝の測定", "größe, mesuré le 3 août"
HEADER = "incidence_deg,receiving_deg,tilt_deg,X,Y,Z\n"


@dataclass(frozen=True)
class Dialect:
    """How a table is written; the defaults are the project's own way."""

    encoding: str = "utf-8"
    separator: str = ","
    comma: bool = False
    ends: str = "\n"
    names: Callable[[str], str] = str
    cell: Callable[[str], str] = str
    before: str = ""
    fill: int = 0
    comment: str = ""
    packed: bool = False

    def bytes(self, text: str) -> bytes:
        """The project's text in this dialect."""
        fill, lines = self.separator * self.fill, []
        above = True
        for line in text.splitlines():
            if line.startswith("#"):
                lines.append(line + fill)
                continue
            cells = [self.names(c) if above else self._cell(c) for c in line.split(",")]
            if above and self.comment:
                lines.append(f"# {self.comment}{fill}")
            above = False
            lines.append(self.separator.join(cells) + fill)
        end = [fill, ""] if self.fill else []
        data = (self.before + self.ends.join([*lines, *end, ""])).encode(self.encoding)
        return gzip.compress(data) if self.packed else data

    def _cell(self, text: str) -> str:
        return self.cell(text.replace(".", ",") if self.comma else text)


UNITS = {"incidence_deg": "Incidence (deg)", "receiving_deg": "receiving [°]", "tilt_deg": "TILT/°"}
OWN = "incidence_deg, receiving_deg, tilt_deg"
SEMICOLONS = Dialect(separator=";", comma=True)
DIALECTS = {
    "the project's": (Dialect(), None),
    "UTF-8 with a mark": (Dialect("utf-8-sig"), None),
    "Excel in Europe": (
        replace(SEMICOLONS, encoding="cp1252", ends="\r\n", comment=WESTERN, fill=2),
        "Windows-1252, semicolon-separated with decimal commas",
    ),
    "semicolons, decimal points": (Dialect(separator=";"), "semicolon-separated"),
    "Excel's hint": (
        replace(SEMICOLONS, before="sep=;\r\n", ends="\r\n"),
        "semicolon-separated with decimal commas",
    ),
    "Excel's Unicode text": (
        Dialect("utf-16", "\t", ends="\r\n", comment=JAPANESE),
        "UTF-16, tab-separated",
    ),
    "UTF-16 of the other order": (
        Dialect("utf-16-be", "\t", comma=True, before="\ufeff"),
        "UTF-16, tab-separated with decimal commas",
    ),
    "Excel in Japan": (Dialect("cp932", ends="\r\n", comment=JAPANESE), "Shift-JIS"),
    "units in Shift-JIS": (
        Dialect("cp932", names=lambda n: UNITS.get(n, n), comment=JAPANESE),
        f"Shift-JIS, columns Incidence (deg), receiving [°], TILT/° as {OWN}",
    ),
    "units in Windows-1252": (
        Dialect("cp1252", names=lambda n: UNITS.get(n, n)),
        f"Windows-1252, columns Incidence (deg), receiving [°], TILT/° as {OWN}",
    ),
    "upper case": (
        Dialect(names=str.upper),
        f"columns INCIDENCE_DEG, RECEIVING_DEG, TILT_DEG as {OWN}",
    ),
    "an old Mac's lines": (Dialect(ends="\r"), None),
    "gzip": (Dialect(packed=True), None),
    "gzip of UTF-16": (Dialect("utf-16", packed=True), "UTF-16"),
    "quoted": (
        replace(SEMICOLONS, names=lambda n: f'"{n}"', cell=lambda c: f'"{c}"'),
        "semicolon-separated with decimal commas",
    ),
    "filled up with empty cells": (Dialect(fill=3), None),
    "spaces": (Dialect(names=lambda n: f" {n} ", cell=lambda c: f" {c}\t"), None),
    "no-break spaces": (Dialect(cell=lambda c: f"\u00a0{c}\u202f"), None),
    "minus signs": (Dialect(cell=lambda c: c.replace("-", "−")), None),
    "Japanese digits": (
        Dialect("cp932", cell=lambda c: c.translate(str.maketrans("-.012", "－．０１２"))),
        "Shift-JIS",
    ),
}


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> tuple[BrdfMeasurement, str]:
    """A measurement, and its file's text."""
    path = tmp_path_factory.mktemp("shell") / "shell.csv"
    measurement = rt.simulate_specimen("yakogai", step_deg=10.0)
    measurement.save(path)
    return measurement, path.read_text("utf-8")


def load(path: Path, warned: str | None) -> BrdfMeasurement:
    """Load a file and check the one warning, or that there is none."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = rt.load_measurement(path)
    assert [str(w.message) for w in caught] == ([f"{path}: read as {warned}"] if warned else [])
    return found


@pytest.mark.parametrize("name", DIALECTS)
def test_a_dialect_is_the_same_measurement(name: str, shell, tmp_path: Path) -> None:
    measurement, text = shell
    dialect, warned = DIALECTS[name]
    path = tmp_path / "shell.csv"
    path.write_bytes(dialect.bytes(text))
    found = load(path, warned)
    assert found.sha256 == measurement.sha256
    notes = measurement.metadata.notes + ((dialect.comment,) if dialect.comment else ())
    assert found == replace(measurement, metadata=replace(measurement.metadata, notes=notes))


@pytest.mark.parametrize("name", DIALECTS)
def test_cells_and_the_white_are_read_alike(name: str, shell, tmp_path: Path) -> None:
    measurement, text = shell
    dialect, warned = DIALECTS[name]
    path = tmp_path / "shell.csv"
    path.write_bytes(dialect.bytes(text))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cells = list_cells(path)
        white = xyz_at(path, Position(*cells[7]))
    said = [str(w.message).replace(" with decimal commas", "") for w in caught]  # cells have none
    expected = f"{path}: read as {warned}".replace(" with decimal commas", "")
    assert said == (2 * [expected] if warned else [])
    angles = [measurement.incidence_deg, measurement.receiving_deg, measurement.tilt_deg]
    np.testing.assert_array_equal(cells, np.stack(angles, axis=1))
    np.testing.assert_allclose(white, measurement.as_xyz().values[7], rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "warned"),
    [
        ("semicolon_decimal_comma", "semicolon-separated with decimal commas"),
        ("shift_jis_header", "Shift-JIS"),
        ("upper_case_columns", f"columns INCIDENCE_DEG, RECEIVING_DEG, TILT_DEG as {OWN}"),
    ],
)
def test_the_shared_cases(name: str, warned: str, shared: Path) -> None:
    """The numbers are those that NumPy reads, once the commas are points."""
    path = shared / f"data/cases/{name}.csv"
    found = load(path, warned)
    rows = [line for line in path.read_bytes().splitlines() if line[:1].isdigit()]
    if "semicolon" in warned:
        rows = [row.replace(b",", b".").replace(b";", b",") for row in rows]
    table = np.loadtxt(rows, delimiter=",")
    assert len(found) == len(table) > 900
    angles = np.stack([found.incidence_deg, found.receiving_deg, found.tilt_deg], axis=1)
    np.testing.assert_array_equal(np.hstack([angles, found.values]), table)
    if name == "shift_jis_header":
        assert "夜光貝" in dict(found.metadata.other)["sample"]


def test_a_spreadsheets_comments(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text(
        '"# material: shell; ""no. 3""";;;;;\n# lamp: xenon;;;;;\n'
        + (HEADER + "0,-70,0,1.5,2,3\n").replace(",", ";").replace(".", ",")
    )
    found = load(path, "semicolon-separated with decimal commas")
    assert found.metadata.sample == 'shell; "no. 3"'
    assert found.metadata.other == (("lamp", "xenon"),)


@pytest.mark.parametrize(
    ("written", "own"),
    [
        ("550 nm", "550nm"),
        ("550 [nm]", "550nm"),
        ("550,5NM", "550.5nm"),
        ("STD_X", "std_X"),
        ("std 550 nm", "std_550nm"),
        ("Incidence angle (degrees)", "incidence_deg"),
        ("incidence\u00a0[°]", "incidence_deg"),
        ("Azimuth deg", "azimuth_deg"),
        ("VALID", "valid"),
        ("incidence", "incidence"),  # degrees or radians?
        ("incidence (rad)", "incidence (rad)"),
        ("x", "x"),  # a chromaticity
        ("incidence std deg", "incidence std deg"),
        ("std_" * 5000, "std_" * 5000),
    ],
)
def test_column_names(written: str, own: str) -> None:
    from raden_torch.measurement.column_names import own_name

    assert own_name(written) == own


def semicolons(rows: str) -> str:
    return HEADER.replace(",", ";") + rows


def tabs(rows: str) -> str:
    return HEADER.replace(",", "\t") + rows


AMBIGUOUS = {
    "decimal commas between commas": (
        HEADER + "0,-70,0,19,5,20,1,21,8\n",
        "line 2: expected 6 values, got 9; decimal commas cannot be told",
    ),
    "quoted decimal commas between commas": (
        HEADER + '0,-70,0,"19,5",20,21\n',
        "line 2, column X: expected a number, got '19,5'",
    ),
    "thousands": (
        semicolons("0;-70;0;1.234,5;20,1;21,8\n"),
        "line 2, column X: expected a number, got '1.234,5'; thousands separators are not read",
    ),
    "thousands with a space": (
        semicolons("0;-70;0;1 234,5;20,1;21,8\n"),
        "expected a number, got '1 234,5'; thousands separators are not read",
    ),
    "thousands twice": (
        semicolons("0;-70;0;1,234,567;1,5;2\n"),
        "expected a number, got '1,234,567'",
    ),
    "commas and points": (
        semicolons("0;-70;0;19,5;20,1;21,8\n5;-70;0;19,5;20.1;21,8\n"),
        "line 2, column X: '19,5' has a decimal comma, '20.1' in line 3, column Y a decimal point",
    ),
    "a comma that may be a thousands separator": (
        tabs("0\t-70\t0\t1,234\t20\t21\n"),
        "line 2, column X: '1,234' may be 1.234 or 1234",
    ),
    "names equal but for case": (
        HEADER.replace("Z", "Z,tilt_DEG") + "0,0,0,1,2,3,4\n",
        "line 1: expected each column once, got tilt_deg twice",
    ),
    "chromaticities": (
        HEADER.replace("X,Y,Z", "x,y,Y") + "0,0,0,1,2,3\n",
        "expected each column once",
    ),
    "a hint of another separator": (
        "sep=;\n" + HEADER + "0,0,0,1,2,3\n",
        "sep=;: expected the separator of the columns, comma",
    ),
    "an open quote": (HEADER + '0,0,0,1,2,"3\n', "line 2: expected a closing quote"),
    "a spreadsheet's error": (
        HEADER + "0,0,0,1,2,#N/A\n",
        "column Z: expected a number, got '#N/A'",
    ),
    "digits with underscores": (
        HEADER + "0,0,0,1,2,1_0\n",
        "column Z: expected a number, got '1_0'",
    ),
    "a row of another length": (
        semicolons("0;0;0;1;2\n5;0;0;1;2;3\n"),
        "line 2: expected 6 values, got 5",
    ),
    "Shift-JIS or Windows-1252": (
        "# 夜\n".encode("cp932") + (HEADER + "0,0,0,1,2,3\n").encode(),
        "line 1: expected UTF-8, or what is clearly Shift-JIS or Windows-1252, got byte 0x96; save",
    ),
    **{
        encoding: (
            f"# {words}\n".encode(encoding) + (HEADER + "0,0,0,1,2,3\n").encode(),
            "expected UTF-8, or what is clearly Shift-JIS or Windows-1252, got byte 0x",
        )
        for encoding, words in SHELL.items()
    },
    "damaged UTF-8": (
        "# 夜光貝の測定\n".encode().replace(b"\x85", b"\x20", 1)
        + (HEADER + "0,0,0,1,2,3\n").encode(),
        "line 1: expected UTF-8, or what is clearly Shift-JIS or Windows-1252, got byte 0xe5",
    ),
    "half a UTF-16 character": (
        (HEADER + "0,0,0,1,2,3\n").encode("utf-16")[:-1],
        "line 2: expected UTF-16, got truncated data",
    ),
    "a NUL character": (HEADER + "0,0,0,1,2,3\n" * 20_000 + "\0", "line 20002: expected text"),
    "a truncated gzip file": (gzip.compress((HEADER + "0,0,0,1,2,3\n").encode())[:-9], "truncated"),
    "a gzip file with another sum": (
        gzip.compress((HEADER + "0,0,0,1,2,3\n").encode())[:-8] + bytes(8),
        "expected a whole gzip file, got a damaged one",
    ),
    "a gzip bomb": (
        gzip.compress(HEADER.encode() + b"0,0,0,1,2,3\n" * 5_000_000, 9),
        "expected at most 50 MB in it, got more",
    ),
}


@pytest.mark.parametrize("name", AMBIGUOUS)
def test_what_is_ambiguous_or_damaged_is_one_line(name: str, tmp_path: Path) -> None:
    content, message = AMBIGUOUS[name]
    path = tmp_path / "m.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError) as error:
        rt.load_measurement(path)
    assert message in str(error.value)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


def test_gzip_members_are_one_file(tmp_path: Path) -> None:
    path = tmp_path / "m.csv.gz"
    text = HEADER.encode(), b"0,0,0,1,2,3\n"
    path.write_bytes(b"".join(map(gzip.compress, text)) + bytes(100))
    assert load(path, None).values.tolist() == [[1, 2, 3]]


def test_many_empty_gzip_members_take_no_time_to_speak_of(tmp_path: Path) -> None:
    path = tmp_path / "m.csv.gz"
    path.write_bytes(
        gzip.compress(b"") * 30_000 + gzip.compress((HEADER + "0,0,0,1,2,3\n").encode())
    )
    assert len(load(path, None)) == 1


def test_other_formats_are_found_and_read_through_their_encoding(tmp_path: Path) -> None:
    text = "type bsdf_data\nformat angles=deg bsdf=value scale=1\n30 0\n30 0 0.5\n"
    path = tmp_path / "a.txt"
    path.write_text(text)
    plain = rt.load_measurement(path)
    path.write_bytes(gzip.compress(text.encode("utf-16")))
    assert load(path, "UTF-16").sha256 == plain.sha256


# -- any measurement, any dialect, any damage ---------------------------------------------------


# Hypothesis also draws constants that it finds in our code, codes for missing values among them
readings = st.floats(-1e6, 1e6).filter(lambda x: x not in _MISSING)


@st.composite
def measurements(draw: st.DrawFn) -> BrdfMeasurement:
    n = draw(st.integers(1, 6))
    column = lambda low, high: draw(  # noqa: E731
        hnp.arrays(float, n, elements=st.floats(low, high), unique=True)
    )
    channels = draw(st.sampled_from([("X", "Y", "Z"), ("R", "G", "B"), ("1nm", "2.5nm", "3nm")]))
    shape = (n, 3)
    return BrdfMeasurement(
        column(2, 90),
        column(-90, 90),
        column(-90, 90),
        draw(hnp.arrays(float, shape, elements=readings | st.just(np.nan))),
        channels=channels,
        std=draw(st.none() | hnp.arrays(float, shape, elements=st.floats(0, 1e3))),
        count=draw(st.none() | hnp.arrays(np.int64, n, elements=st.integers(1, 10**9))),
        valid=draw(hnp.arrays(bool, n)),
        metadata=Metadata("a shell", simulated=draw(st.booleans())),
    )


@st.composite
def dialects(draw: st.DrawFn) -> Dialect:
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp932", "cp1252"]))
    separator = draw(st.sampled_from(",;\t"))
    comments = {"cp1252": WESTERN, "cp932": JAPANESE}
    cells = [str, lambda c: f'"{c}"', lambda c: f" {c} ", lambda c: "" if c == "nan" else c]
    return Dialect(
        encoding,
        separator,
        comma=separator != "," and draw(st.booleans()),
        ends=draw(st.sampled_from(["\n", "\r\n", "\r"])),
        names=draw(st.sampled_from([str, lambda n: n.replace("_deg", " (deg)")])),
        cell=draw(st.sampled_from(cells)),
        before=draw(st.sampled_from(["", f"sep={separator}\n"])),
        fill=draw(st.integers(0, 2)),
        comment=comments.get(encoding, draw(st.sampled_from(["", JAPANESE, WESTERN]))),
        packed=draw(st.booleans()),
    )


def own_text(folder: Path, measurement: BrdfMeasurement) -> str:
    measurement.save(folder / "own.csv")
    return (folder / "own.csv").read_text("utf-8")


@settings(max_examples=100, deadline=None)
@given(measurement=measurements(), dialect=dialects())
def test_any_measurement_in_any_dialect(tmp_path_factory, measurement, dialect) -> None:
    folder = tmp_path_factory.mktemp("dialect")
    path = folder / "m.csv"
    path.write_bytes(dialect.bytes(own_text(folder, measurement)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = rt.load_measurement(path)
        except InputError as error:  # every number of it has three decimals, or none
            assert "may be" in str(error)  # noqa: PT017
            assert dialect.separator == "\t"
            assert dialect.comma
            return
    notes = (dialect.comment,) if dialect.comment else ()
    assert found == replace(measurement, metadata=replace(measurement.metadata, notes=notes))


@settings(max_examples=200, deadline=None)
@given(dialect=dialects(), where=st.floats(0, 1), flip=st.integers(1, 255))
def test_a_damaged_byte_anywhere(tmp_path_factory, dialect, where: float, flip: int) -> None:
    data = bytearray(dialect.bytes("# note: x\n" + HEADER + "0,-70,0,19.5,20.1,1\n5,0,0,1,2,3\n"))
    data[round(where * (len(data) - 1))] ^= flip
    path = tmp_path_factory.mktemp("damage") / "m.csv"
    path.write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for read in (rt.load_measurement, list_cells):
            try:
                read(path)
            except InputError as error:
                assert str(error).startswith(f"{path}: ")  # noqa: PT017
                assert "\n" not in str(error)  # noqa: PT017
