"""LightTools' own BSDF and SPEOS' anisotropic one, written by hand; what is wrong is one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.exchange import load_measurement
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.readings import FACTOR_PER_SR, XYZ

LIGHTTOOLS = """# Sample: simulated card
Symmetry Asymmetric
SpectralContent Monochrome
ScatterAzimuth 3
90 180 270
ScatterRadial 2
0 40
DataBegin
AOI 30
POI 0
Side Front
Wavelength 633
ScatterType BRDF
TIS 0.5
0.3 0.1
0.3 0.2
0.3 0.4
AOI 30 POI 0 Side Back ScatterType BRDF TIS 0.1
9 9 9 9 9 9
AOI 30 POI 0 Side Front ScatterType BTDF TIS 0.1
9 9 9 9 9 9
DataEnd
"""
SPEOS = """OPTIS - Anisotropic BSDF surface file v7.0
0
Comment
4
card
0 1 0
1 0
1
1
0
1
30
30 0

2
350 50
850 50
2 4
0 90 180 270
0 1 1 1 1
40 4 2 1 2
End of file
"""


def read(tmp_path: Path, text: str) -> BrdfMeasurement:
    path = tmp_path / "a.bsdf"
    path.write_text(text, encoding="utf-8")
    return load_measurement(path)


def at(m: BrdfMeasurement, a: float, r: float, t: float) -> np.ndarray:
    near = abs(m.angles_deg - [a, r, t]).max(axis=1) < 1e-6
    assert near.sum() == 1
    return m.values[near][0]


def test_lighttools_has_the_light_at_azimuth_90(tmp_path: Path) -> None:
    """Expectation: the mirror's side is 270, the lamp's 90; the pole is one reading; blocks of the
    back and of transmission are left out."""
    m = read(tmp_path, LIGHTTOOLS)
    assert (m.channels, len(m), m.metadata.sample) == (("633nm",), 4, "card")
    assert m.metadata.simulated
    assert "2 blocks of transmission or of the back left out" in m.metadata.notes
    for receiving, f in ((40, 0.4), (-40, 0.1), (0, 0.3)):
        np.testing.assert_allclose(at(m, 30, receiving, 0), f * FACTOR_PER_SR)


def test_lighttools_tristimulus_values_come_in_any_order(tmp_path: Path) -> None:
    head, _, _ = LIGHTTOOLS.partition("AOI")
    blocks = [
        f"AOI 30 POI 0 Side Front TristimulusValue Tris{c} ScatterType BRDF TIS 1 "
        + " ".join([str(f)] * 6)
        for c, f in (("Z", 0.3), ("X", 0.1), ("Y", 0.2))
    ]
    text = head.replace("Monochrome", "XYZ") + "\n".join(blocks) + "\nDataEnd\n"
    m = read(tmp_path, text)
    assert m.channels == XYZ
    np.testing.assert_allclose(m.values, FACTOR_PER_SR * np.array([[0.1, 0.2, 0.3]] * 4))
    with pytest.raises(InputError, match=r"AOI 30: expected 3 blocks \(XYZ\), got 2"):
        read(tmp_path, text.replace(blocks[1], ""))
    with pytest.raises(InputError, match="expected another AOI, got one twice"):
        read(tmp_path, text.replace("TrisZ", "TrisX"))


def test_speos_is_scaled_by_its_spectrum(tmp_path: Path) -> None:
    """Rationale: the trapezoidal rule by hand: over polar angles 0 and 40, cos θ sin θ is 0 and
    cos 40 sin 40; azimuths have a quarter turn each."""
    m = read(tmp_path, SPEOS)
    forty = np.deg2rad(40)
    total = 0.5 * forty * np.cos(forty) * np.sin(forty) * (np.pi / 2) * (4 + 2 + 1 + 2)
    scale = 0.5 / total
    assert any(note.startswith("values times") for note in m.metadata.notes)
    for receiving, f in ((40, 4), (-40, 1), (0, 1)):
        np.testing.assert_allclose(at(m, 30, receiving, 0), scale * f * FACTOR_PER_SR, rtol=1e-6)
    cosine = SPEOS.replace("1 0\n1\n1\n", "1 0\n0\n1\n")
    with_cosine = read(tmp_path, cosine)  # values are BSDF · cos θ
    ratio = at(with_cosine, 30, 40, 0) / at(with_cosine, 30, 0, 0)
    np.testing.assert_allclose(ratio, 4 / np.cos(forty))


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (LIGHTTOOLS, "DataEnd\n", "", "expected a block's AOI, or DataEnd, got the end"),
        (LIGHTTOOLS, "0.3 0.4\nAOI", "0.3\nAOI", "line 18, column values: .*, got 'AOI"),
        (LIGHTTOOLS, "AOI 30\n", "AOI 95\n", "line 9: AOI: expected 0…90, got 95"),
        (LIGHTTOOLS, "Side Front", "Side Top", "line 11: Side: expected Front or Back, got 'Top'"),
        (LIGHTTOOLS, "Side Front", "Side Back", "expected the front's reflection .*, got 3 blocks"),
        (LIGHTTOOLS, "ScatterRadial 2", "ScatterRadial 9999", "expected 9999 angles of Sc"),
        (LIGHTTOOLS, "ScatterAzimuth 3", "ScatterAzimuth x", "ScatterAzimuth: expected a whole"),
        (LIGHTTOOLS, "TIS 0.5", "Tint 0.5", "line 14: expected AOI, .* or TIS, got 'Tint'"),
        (SPEOS, "v7.0\n0", "v7.0\n1", r"line 2: expected 0 \(text mode\), got '1'"),
        (SPEOS, "1 0\n1\n1", "0 1\n1\n1", r"line 7: expected '1 0' \(reflection, no trans"),
        (SPEOS, "40 4 2 1 2\n", "", "line 19: expected 10 numbers of a table, got 8"),
        (SPEOS, "2 4\n", "4096 4096\n", "expected a table of 4096 x 4096, got at most 17 numbers"),
        (SPEOS, "350 50\n850 50", "350 0\n850 0", "expected a spectrum and a table above 0"),
        (SPEOS, "End of file", "7 7", "line 22: expected 'End of file', got more"),
        (SPEOS, "1\n30\n30 0", "1\n95\n30 0", "incidences: expected at most 90 degrees, got 95"),
        (SPEOS, "\n4\ncard", "\n4e9\ncard", "line 4: characters: expected a whole number"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(tmp_path: Path, text: str, old: str, new: str, message: str) -> None:
    assert old in text
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, text.replace(old, new, 1))
    assert "\n" not in str(caught.value)


def test_a_transmission_file_of_zemax_is_refused(tmp_path: Path) -> None:
    text = "Source Measured\nSymmetry Asymmetrical\nSpectralContent Monochrome\nScatterType BTDF\n"
    with pytest.raises(InputError, match="line 4: ScatterType: expected BRDF, got 'BTDF'"):
        read(tmp_path, text)
