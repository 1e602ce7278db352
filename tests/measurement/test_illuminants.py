"""Illuminants: colours against colour-science, names, files and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import colour
import numpy as np
import pytest
from colour.utilities import suppress_warnings

from raden_torch.colorimetry import XYZ_TO_SRGB
from raden_torch.errors import InputError
from raden_torch.measurement.illuminants import Illuminant

NM = np.arange(380.0, 781.0, 5.0)
OBSERVER = "CIE 1931 2 Degree Standard Observer"


def _smooth_spectra(count: int) -> np.ndarray:
    random = np.random.default_rng(3)
    centre, width = random.uniform(400, 700, (count, 1)), random.uniform(30, 150, (count, 1))
    return 0.1 + 0.8 * np.exp(-(((NM - centre) / width) ** 2))


@pytest.mark.parametrize("name", ["D65", "A", "FL11", "LED-B3", "HP1"])
def test_colours_are_those_of_colour_science(name: str) -> None:
    spectra = _smooth_spectra(6)
    table = colour.MultiSpectralDistributions(spectra.T, NM)
    cmfs = colour.MSDS_CMFS[OBSERVER]
    light = colour.SDS_ILLUMINANTS[name]
    with suppress_warnings(colour_runtime_warnings=True):  # ASTM E308, another way to integrate
        wanted = colour.msds_to_XYZ(table, cmfs, light) / 100
    found = spectra @ Illuminant.of(name).xyz_weights(NM)
    # the tables of lamps with lines have 5 nm, and are joined otherwise there
    assert abs(found - wanted).max() < (8e-3 if name in ("FL11", "HP1") else 2e-3)
    adapted = colour.chromatic_adaptation(
        found,
        Illuminant.of(name).xyz_weights(NM).sum(0),
        colour.xy_to_XYZ((0.3127, 0.3290)),
        method="Von Kries",
        transform="Bradford",
    )
    rgb = spectra @ Illuminant.of(name).rgb_weights(NM)
    assert abs(rgb - adapted @ XYZ_TO_SRGB.T).max() < 5e-4


def test_white_is_white_or_as_it_is() -> None:
    warm, day = Illuminant.of("A"), Illuminant.of("D65")
    assert warm.rgb_weights(NM).sum(0) == pytest.approx([1, 1, 1], abs=1e-12)
    seen = warm.rgb_weights(NM, white=day).sum(0)
    assert seen == pytest.approx(XYZ_TO_SRGB @ warm.xyz_weights(NM).sum(0), abs=2e-3)
    assert seen[0] > 1.5 > 0.5 > seen[2]


def test_names_in_any_case_and_the_nearest_of_others() -> None:
    assert Illuminant.of("f11").name == Illuminant.of("FL11").name == "FL11"
    assert Illuminant.of(" led-b3").name == "LED-B3"
    for wrong, near in (("FL13", "FL1"), ("LED-B9", "LED-B5"), ("D56", "D65")):
        with pytest.raises(InputError, match=rf"got '{wrong}'; did you mean .*{near}") as error:
            Illuminant.of(wrong)
        assert "\n" not in str(error.value)


def test_a_lamp_from_a_file(tmp_path: Path) -> None:
    table = colour.SDS_ILLUMINANTS["A"]
    rows = [f"{nm:g},{power!r}" for nm, power in zip(table.wavelengths, table.values, strict=True)]
    path = tmp_path / "lamp.csv"
    path.write_text("\n".join(["# measured at the desk", "wavelength_nm,power", *rows]))
    lamp = Illuminant.of(path)
    assert lamp.name == "lamp"
    found, wanted = lamp.rgb_weights(NM), Illuminant.of("A").rgb_weights(NM)
    assert abs(found - wanted).max() < 1e-4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nm,power\n400,1\n", "expected columns wavelength_nm,power, got nm,power"),
        ("wavelength_nm,power\n500,1\n700,1\n", "expected wavelengths that rise from 420 nm"),
        ("wavelength_nm,power\n400,1\n700,1\n", "expected steps of at most 20 nm, got 300 nm"),
        ("wavelength_nm,power\n", "expected wavelengths that rise"),
        ("", "got an empty file"),
        ("wavelength_nm,power\n400,x\n", "expected"),
    ],
)
def test_what_is_wrong_with_a_file(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "lamp.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        Illuminant.of(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_lamp_has_no_negative_power(tmp_path: Path) -> None:
    path = tmp_path / "lamp.csv"
    rows = "".join(f"{nm},{-1 if nm == 500 else 1}\n" for nm in range(400, 701, 10))
    path.write_text("wavelength_nm,power\n" + rows)
    with pytest.raises(InputError, match="power: expected numbers of 0 or more"):
        Illuminant.of(path)
