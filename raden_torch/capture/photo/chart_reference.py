"""What colours a ColorChecker Classic's patches have, as its maker publishes them."""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.errors import InputError

PATCH_NAMES = (
    "dark skin", "light skin", "blue sky", "foliage", "blue flower", "bluish green",
    "orange", "purplish blue", "moderate red", "purple", "yellow green", "orange yellow",
    "blue", "green", "red", "yellow", "magenta", "cyan",
    "white 9.5", "neutral 8", "neutral 6.5", "neutral 5", "neutral 3.5", "black 2",
)  # fmt: skip
NEUTRAL = range(18, 24)


def reference_xyz(edition: str = "2014") -> Floats:
    """`[24, 3]` CIE 1931 2° XYZ of the patches under D65, the perfect diffuser's Y being 1.

    X-Rite's published values under D50, through colour-science, adapted by the Bradford transform.

    Args:
        edition: "2014" for charts made after November 2014, "2005" for older ones.

    Raises:
        InputError: another edition.
    """
    import colour

    names = {
        "2014": "ColorChecker24 - After November 2014",
        "2005": "ColorChecker24 - Before November 2014",
    }
    if edition not in names:
        raise InputError(f"chart edition: expected {' or '.join(names)}, got {edition!r}")
    reference = colour.CCS_COLOURCHECKERS[names[edition]]
    xyz = colour.xyY_to_XYZ(np.array(list(reference.data.values())))
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    source, target = (
        colour.xy_to_XYZ(xy) for xy in (np.asarray(reference.illuminant), np.asarray(white))
    )
    adapted = colour.adaptation.chromatic_adaptation_VonKries(
        xyz, source, target, transform="Bradford"
    )
    return np.asarray(adapted, np.float64)
