"""Illuminants by name or from a file, and what turns spectral bands into colours under them.

    X = k Σ S(λ) R(λ) x̄(λ) Δλ,  k = 1 / Σ S(λ) ȳ(λ) Δλ

(CIE 015:2018, §7.1), at steps of 1 nm over 360…780 nm, with colour-science's tables. Bands are
joined linearly and held constant beyond the first and last.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.colorimetry import WHITES_2_DEG, XYZ_TO_SRGB, bradford, xyz_of_white
from raden_torch.errors import InputError
from raden_torch.measurement.csv_table import open_table
from raden_torch.packages import require

OBSERVERS = {  # as colour-science calls them
    "CIE 1931 2 deg": "CIE 1931 2 Degree Standard Observer",
    "CIE 1964 10 deg": "CIE 1964 10 Degree Standard Observer",
}

_NM = np.arange(360.0, 780.5)
_FILES = (".csv", ".txt")
_COLUMNS = ("wavelength_nm", "power")
_MOST_BYTES = 1_000_000
_LAMP_SPAN_NM = (420.0, 680.0)
_COARSEST_LAMP_NM = 20.0


@dataclass(frozen=True, eq=False)
class Illuminant:
    """A lamp's relative spectral power.

    Attributes:
        name: as the CIE has it, or the file's.
        power: `[421]` at 360, 361, … 780 nm, in any unit.
    """

    name: str
    power: Floats

    @classmethod
    def of(cls, name: str | os.PathLike[str]) -> Illuminant:
        """One that colour-science knows, in any case ("A", "D65", "FL11" or "F11", "LED-B3"), or
        the table in a file.

        Args:
            name: of an illuminant; or of a .csv or .txt file with the columns wavelength_nm and
                power, which rise in steps of at most 20 nm from 420 nm or less to 680 nm or more;
                no light is taken to lie beyond them.

        Raises:
            InputError: no such illuminant, with the nearest names; a file that is not such a table.
        """
        if Path(name).suffix.lower() in _FILES:
            return _of_file(Path(name))
        require("illuminants", "spectral")
        import colour

        asked, known = str(name).strip(), {n.casefold(): n for n in colour.SDS_ILLUMINANTS}
        key = re.sub(r"^f(?=\d)", "fl", asked.casefold())  # the CIE's older name of fluorescent
        if key not in known:
            near = get_close_matches(key, known, n=3, cutoff=0.5)
            hint = f"did you mean {', '.join(known[n] for n in near)}?" if near else "as D65 or A"
            raise InputError(
                f"illuminant: expected a name of the CIE's or a .csv file, got {asked!r}; {hint}"
            )
        table = colour.SDS_ILLUMINANTS[known[key]].copy().align(colour.SpectralShape(360, 780, 1))
        return cls(known[key], np.asarray(table.values, np.float64))

    def xyz_weights(self, wavelengths_nm: Floats, observer: str = "CIE 1931 2 deg") -> Floats:
        """`[N, 3]`: bands `[…, N]` @ weights is X, Y, Z; Y of the perfect diffuser is 1."""
        require("colours of spectral bands", "spectral")
        import colour

        cmfs = colour.MSDS_CMFS[OBSERVERS[observer]].copy().align(colour.SpectralShape(360, 780, 1))
        lit = np.asarray(cmfs.values, np.float64) * self.power[:, None]
        share = np.stack(
            [np.interp(_NM, wavelengths_nm, row) for row in np.eye(len(wavelengths_nm))]
        )
        return np.asarray(share @ lit / lit[:, 1].sum())

    def rgb_weights(self, wavelengths_nm: Floats, white: Illuminant | None = None) -> Floats:
        """`[N, 3]`: bands `[…, N]` @ weights is linear RGB with sRGB primaries, unclipped.

        Args:
            white: what an eye is adapted to, by the Bradford transform: a perfect diffuser under
                it is 1, 1, 1. None: this illuminant itself. D65 adapts nothing.
        """
        to_xyz = self.xyz_weights(wavelengths_nm)
        source = (self if white is None else white).xyz_weights(wavelengths_nm).sum(axis=0)
        to_rgb = XYZ_TO_SRGB @ bradford(source, xyz_of_white(WHITES_2_DEG["D65"]))
        # the matrix of the standard is rounded: white is made white to the last digit
        return np.asarray(to_xyz @ to_rgb.T / (to_rgb @ source))


def _of_file(path: Path) -> Illuminant:
    table = open_table(path, _MOST_BYTES, _COLUMNS)
    missing = [name for name in _COLUMNS if name not in table.columns]
    if missing:
        raise InputError(
            f"{path}: expected columns {','.join(_COLUMNS)}, got {','.join(table.columns)[:80]}"
        )
    nm, power = table.numbers(_COLUMNS).T
    low, high = _LAMP_SPAN_NM
    if len(nm) < 2 or (np.diff(nm) <= 0).any() or nm[0] > low or nm[-1] < high:
        raise InputError(
            f"{path}: wavelength_nm: expected wavelengths that rise from {low:g} nm or less to "
            f"{high:g} nm or more, got {len(nm)} from {nm[0] if len(nm) else 0:g} nm"
        )
    if np.diff(nm).max() > _COARSEST_LAMP_NM:
        raise InputError(
            f"{path}: wavelength_nm: expected steps of at most {_COARSEST_LAMP_NM:g} nm, got "
            f"{np.diff(nm).max():g} nm"
        )
    if not np.isfinite(power).all() or (power < 0).any() or not (power > 0).any():
        raise InputError(f"{path}: power: expected numbers of 0 or more, and some above 0")
    return Illuminant(path.stem, np.interp(_NM, nm, power, left=0.0, right=0.0))
