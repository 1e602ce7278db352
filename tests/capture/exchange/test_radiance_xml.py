"""WINDOW's and Radiance's XML: Klems matrices and tensor trees by a writer of the tests' own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.capture.exchange import load_measurement
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.readings import FACTOR_PER_SR, XYZ

Brdf = Callable[[np.ndarray, np.ndarray], np.ndarray]
HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<WindowElement xmlns="http://windows.lbl.gov">
<WindowElementType>System</WindowElementType><Optical><Layer>
<Material><Name>shell</Name><Manufacturer>the sea</Manufacturer></Material>
<DataDefinition><IncidentDataStructure>{structure}</IncidentDataStructure>{bases}</DataDefinition>
"""
BLOCK = """<WavelengthData><LayerNumber>System</LayerNumber>
<Wavelength unit="Integral">{wavelength}</Wavelength>
<WavelengthDataBlock><WavelengthDataDirection>{side}</WavelengthDataDirection>
<ColumnAngleBasis>LBNL/Klems {size}</ColumnAngleBasis>
<RowAngleBasis>LBNL/Klems {size}</RowAngleBasis>
<AngleBasis>LBNL/Shirley-Chiu</AngleBasis><ScatteringDataType>BRDF</ScatteringDataType>
<ScatteringData>{data}</ScatteringData></WavelengthDataBlock></WavelengthData>
"""
TAIL = "</Layer></Optical></WindowElement>\n"
QUARTER = ((0, 9, 27, 46, 66, 90), (1, 8, 12, 12, 8))


def lopsided(light: np.ndarray, view: np.ndarray) -> np.ndarray:
    """f_r `[M]`, isotropic: a lobe about the mirror, and a part that tells left from right."""
    half = light + view
    cosine = half[2] / np.linalg.norm(half, axis=0)
    side = light[0] * view[1] - light[1] * view[0]
    return 0.2 + 0.3 * cosine**40 + 0.1 * side


def patches() -> tuple[np.ndarray, np.ndarray]:
    """Middles by LBNL's bounds, as Radiance's bsdf_m.c numbers them; the first is the pole."""
    bounds, counts = QUARTER
    theta, phi = [], []
    for low, high, count in zip(bounds[:-1], bounds[1:], counts, strict=True):
        for n in range(count):
            theta.append(0.0 if count == 1 else (low + high) / 2)
            phi.append(360 * n / count)
    return np.deg2rad(theta), np.deg2rad(phi)


def matrix(f: Brdf, *, by_rows: bool = False, from_behind: bool = False) -> str:
    """Numbers by the indices of bsdf_m.c: `o * incidents + i`, or the other way round."""
    theta, phi = patches()
    out = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    into = np.stack([-out[0], -out[1], out[2]])
    i, o = (x.ravel() for x in np.indices((len(theta), len(theta))))
    light, view = into[:, i], out[:, o]
    if from_behind:  # Radiance has z down there; looked at from that side, y is mirrored
        light, view = light * [[1], [-1], [1]], view * [[1], [-1], [1]]
    table = f(light, view).reshape(len(theta), len(theta))
    return " ".join(f"{x:.9g}," for x in (table if by_rows else table.T).ravel())


def xml(structure: str, *blocks: tuple[str, str, str], size: str = "Quarter") -> str:
    parts = [
        BLOCK.format(wavelength=w, side=side, data=data, size=size) for w, side, data in blocks
    ]
    return HEAD.format(structure=structure, bases="") + "".join(parts) + TAIL


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "a.xml"
    path.write_text(text, encoding="utf-8")
    return path


def check(m: BrdfMeasurement, f: Brdf, rtol: float = 1e-6) -> None:
    """Every reading is the formula's, at our angles."""
    angles = (torch.from_numpy(np.deg2rad(x))[None, :, None] for x in m.angles_deg.T)
    light, view = (v[..., 0].numpy() for v in rt.vectors_from_angles(*angles)[1:])
    np.testing.assert_allclose(m.values[:, 0], FACTOR_PER_SR * f(light, view), rtol=rtol)


@pytest.mark.parametrize("by_rows", [False, True])
@pytest.mark.parametrize("side", ["Reflection Front", "Reflection Back"])
def test_a_klems_matrix_is_read(tmp_path: Path, side: str, by_rows: bool) -> None:
    """Rationale: the formula tells left from right, so a mirrored side shows. What WINDOW calls
    front is seen from behind by Radiance."""
    data = matrix(lopsided, by_rows=by_rows, from_behind=side == "Reflection Front")
    text = xml("Rows" if by_rows else "Columns", ("Visible", side, data), ("NIR", side, "0"))
    m = load_measurement(written(tmp_path, text))
    assert (m.metadata.sample, m.channels, m.azimuths) == ("shell", ("550nm",), 16)
    assert 1200 < len(m) <= 41 * 41
    assert abs(m.angles_deg).max() < 80
    check(m, lopsided)


def test_three_wavelengths_are_a_colour(tmp_path: Path) -> None:
    grey = matrix(lopsided)
    blocks = [(w, "Reflection Back", grey) for w in ("Visible", "CIE-X", "CIE-Z")]
    m = load_measurement(written(tmp_path, xml("Columns", *blocks)))
    assert m.channels == XYZ
    rgb = m.as_rgb().values
    np.testing.assert_allclose(rgb, rgb[:, 1:2] * np.ones(3), rtol=2e-3)  # a grey stays one


def disk(u: float, v: float) -> tuple[float, float]:
    """Shirley and Chiu's map by its four regions."""
    a, b = 2 * u - 1, 2 * v - 1
    if a > -b:
        r, phi = (a, np.pi / 4 * b / a) if a > b else (b, np.pi / 4 * (2 - a / b))
    elif a < b:
        r, phi = -a, np.pi / 4 * (4 + b / a)
    else:
        r, phi = -b, np.pi / 4 * (6 - a / b) if b else 0.0
    return r * np.cos(phi), r * np.sin(phi)


def tree(f: Brdf, rank: int, depth: int) -> str:
    """A full tree: braces to `depth`, and a grid of two a side in each leaf."""

    def value(place: np.ndarray) -> float:
        if rank == 4:
            x, y = disk(*place[:2])
            into = np.array([-x, -y])
        else:
            if place[0] > 0.5:
                return 0.0
            into = np.array([2 * place[0] - 1, 0.0])
        out = np.array(disk(*place[-2:]))
        light, view = (np.append(v, np.sqrt(1 - v @ v))[:, None] for v in (into, out))
        return float(f(light, view)[0])

    def node(corner: np.ndarray, width: float, level: int) -> str:
        if level == depth:
            places = np.indices((2,) * rank).reshape(rank, -1).T
            words = [f"{value(corner + width * (p + 0.5) / 2):.9g}" for p in places]
            return "{" + " ".join(words) + "}"
        halves = [np.array([n >> d & 1 for d in range(rank)]) for n in range(1 << rank)]
        below = [node(corner + h * width / 2, width / 2, level + 1) for h in halves]
        return "{" + "\n".join(below) + "}"

    return node(np.zeros(rank), 1.0, 0)


@pytest.mark.parametrize(("rank", "depth"), [(3, 3), (4, 2)])
def test_a_tensor_tree_is_read(tmp_path: Path, rank: int, depth: int) -> None:
    """Expectation: a reading a leaf, by bsdf_t.c's order of branches and of numbers."""
    text = xml(f"TensorTree{rank}", ("Visible", "Reflection Back", tree(lopsided, rank, depth)))
    m = load_measurement(written(tmp_path, text))
    leaves = (2 ** (depth + 1)) ** rank / (2 if rank == 3 else 1)
    assert 0.7 * leaves < len(m) <= leaves
    check(m, lopsided, rtol=1e-5)


def test_one_leaf_becomes_eighths(tmp_path: Path) -> None:
    """A perfect diffuser, as Radiance's documents write it."""
    text = xml("TensorTree3", ("Visible", "Reflection Back", "{ 0.3183098862 }"))
    m = load_measurement(written(tmp_path, text))
    assert len(m) > 200
    np.testing.assert_allclose(m.values, 100, rtol=1e-8)


GOOD = xml("Columns", ("Visible", "Reflection Back", matrix(lopsided)))
TREE = xml("TensorTree3", ("Visible", "Reflection Back", "{ 1 2 3 4 5 6 7 8 }"))


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (
            GOOD,
            "Reflection Back",
            "Transmission Front",
            "Reflection Front' or .*, got transm",
        ),
        (GOOD, "Visible", "Solar", "of Wavelength Visible, got reflection back"),
        (
            GOOD,
            "Columns",
            "Lines",
            "IncidentDataStructure: expected Rows, .*, got 'lines'",
        ),
        (
            GOOD,
            "Klems Quarter",
            "Klems Tenth",
            "ColumnAngleBasis: expected LBNL/.*Tenth",
        ),
        (GOOD, "Klems Quarter", "Klems Full", "expected 145 x 145 numbers, got 1681"),
        (
            GOOD,
            "<ScatteringData>",
            "<ScatteringData>x ",
            "ScatteringData: .* a number, got 'x'",
        ),
        (GOOD, "</ScatteringData>", "", "expected whole XML, got an error"),
        (GOOD, "<Optical>", "<!DOCTYPE a><Optical>", "expected XML without a DOCTYPE"),
        (TREE, "{ 1 2 3 4 5 6 7 8 }", "{ 1 2 3 }", "expected 1, 8, 64, .* numbers .*, got 3"),
        (TREE, "7 8 }", "7 8", "tensor tree: expected '}', got the end: it is truncated"),
        (TREE, "{ 1", "1", "tensor tree: expected '{', got '1'"),
        (TREE, "8 }", "8 } }", "tensor tree: expected its end, got '}'"),
        (TREE, "1 2", "1 nan", "tensor tree: expected numbers, got "),
        (TREE, "Shirley-Chiu", "Klems", "AngleBasis: expected LBNL/Shirley-Chiu"),
    ],
)
def test_bad_input_is_one_line(tmp_path: Path, text: str, old: str, new: str, message: str) -> None:
    assert old in text
    with pytest.raises(InputError, match=message) as caught:
        load_measurement(written(tmp_path, text.replace(old, new)))
    assert "\n" not in str(caught.value)


def test_a_file_cut_anywhere_is_refused(tmp_path: Path) -> None:
    for share in (0.2, 0.5, 0.9, 0.99):
        with pytest.raises(InputError):
            load_measurement(written(tmp_path, GOOD[: int(share * len(GOOD))]))


def test_a_file_may_bring_its_own_basis(tmp_path: Path) -> None:
    own = (
        "<AngleBasis><AngleBasisName>mine</AngleBasisName>"
        "<AngleBasisBlock><nPhis>1</nPhis><ThetaBounds><UpperTheta>30</UpperTheta></ThetaBounds>"
        "</AngleBasisBlock><AngleBasisBlock><nPhis>2</nPhis><ThetaBounds>"
        "<UpperTheta>90</UpperTheta></ThetaBounds></AngleBasisBlock></AngleBasis>"
    )
    block = BLOCK.format(
        wavelength="Visible", side="Reflection Back", size="", data="1 2 3 4 5 6 7 8 9"
    ).replace("LBNL/Klems ", "mine")
    text = HEAD.format(structure="Columns", bases=own) + block + TAIL
    m = load_measurement(written(tmp_path, text))
    mirror = np.isclose(m.incidence_deg, 60) & np.isclose(m.receiving_deg, 60)
    np.testing.assert_allclose(sorted(m.values[mirror, 0] / FACTOR_PER_SR), [5, 9])
    text = text.replace("<nPhis>2", "<nPhis>0")
    with pytest.raises(InputError, match="AngleBasis 'mine': expected ascending bounds"):
        load_measurement(written(tmp_path, text))
