"""How often `raden analyse` is right: tablets of simulated shells, and what its intervals cover.

    python benchmarks/tablets.py [--repeats 100] [--seed 7] [--optics same|other] [--out DIR]

Each repeat is a shell of its own: tablets of 300 to 520 nm, spread 3 to 8 %, organic sheets of
25 ± 5 nm, which the fit is not told, 60 random stacks drawn anew, 2 % noise, X, Y, Z and bands by
turns. With `--optics other` the shells are not made of the fit's optics: index of the sheets 1.40
to 1.57, dispersion of the tablets 0.5 to 1.5 times calcite's, k 2e-4 to 1e-3, spread of the sheets
10 to 30 %. Prints the table of docs/accuracy.md and writes tablets_OPTICS.json. 100 repeats take
some five minutes.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from raden_torch.errors import InputError
from raden_torch.measurement.readings import XYZ, BrdfMeasurement
from raden_torch.optics.nacre import Stack
from raden_torch.optics.shell import BANDS_NM, Specimen
from raden_torch.optics.specimens import SPECIMENS, reflectance_factors
from raden_torch.optics.tablet_fit import TabletEstimate, estimate_tablets

RIDGE_DEG = np.array([(a, a, t) for a in np.arange(0, 71, 5.0) for t in (-10, -5, 0, 5, 10)])
NOISE = 0.02
STACKS = 60


def shell_of(repeat: int, seed: int, optics: str) -> Specimen:
    rng = np.random.default_rng((seed, repeat))
    tablet, spread, organic = rng.uniform(300, 520), rng.uniform(0.03, 0.08), rng.normal(25, 5)
    stack = Stack(tablet, spread, max(8.0, organic))
    if optics == "other":
        stack = replace(
            stack,
            organic_n=rng.uniform(1.40, 1.57),
            dispersion=rng.uniform(0.5, 1.5),
            loss=10 ** rng.uniform(-3.7, -3),
            organic_spread=rng.uniform(0.1, 0.3),
        )
    drawn = int(rng.integers(1 << 30))
    shell = replace(SPECIMENS["yakogai"], stack=stack, steep_tablet_nm=tablet)
    return replace(shell, stacks=STACKS, stack_seed=drawn)


def readings_of(shell: Specimen, repeat: int) -> BrdfMeasurement:
    spectral = bool(repeat % 2)
    values = reflectance_factors(shell, RIDGE_DEG, spectral=spectral)
    std = NOISE * np.maximum(values, 1)
    values = values + std * np.random.default_rng(repeat).standard_normal(values.shape)
    channels = tuple(f"{band:g}nm" for band in BANDS_NM) if spectral else XYZ
    return BrdfMeasurement(*RIDGE_DEG.T, values=values, channels=channels, std=std)


def row_of(stack: Stack, found: TabletEstimate) -> dict[str, Any]:
    low, high = found.tablet_interval_nm
    s_low, s_high = found.spread_interval
    return {
        "truth": asdict(stack),
        "found": asdict(found),
        "within 3 %": bool(abs(found.tablet_nm / stack.tablet_nm - 1) < 0.03),
        "thickness covered": bool(low <= stack.tablet_nm <= high),
        "spread covered": bool(s_low <= stack.tablet_spread <= s_high),
        "period error, nm": found.period_nm - stack.tablet_nm - stack.organic_nm,
        "log spread error": float(np.log(found.spread / stack.tablet_spread)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--optics", choices=["same", "other"], default="same")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    given = parser.parse_args()
    rows, refused = [], []
    for repeat in range(given.repeats):
        shell = shell_of(repeat, given.seed, given.optics)
        try:
            rows.append(row_of(shell.stack, estimate_tablets(readings_of(shell, repeat))))
        except InputError as error:
            refused.append({"truth": asdict(shell.stack), "said": str(error)})
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / f"tablets_{given.optics}.json"
    path.write_text(json.dumps({"seed": given.seed, "rows": rows, "refused": refused}, indent=1))
    print(f"| {given.optics} optics, seed {given.seed} | of {given.repeats} |\n|---|---|")
    for name in ("within 3 %", "thickness covered", "spread covered"):
        print(f"| {name} | {sum(row[name] for row in rows)} |")
    period, spread = (
        np.array([r[k] for r in rows]) for k in ("period error, nm", "log spread error")
    )
    print(f"| period: RMS error, nm | {np.sqrt(np.mean(period**2)):.2f} |")
    print(f"| spread: median, RMS error, % | {100 * np.median(spread):.1f}, "
          f"{100 * np.sqrt(np.mean(spread**2)):.1f} |")  # fmt: skip
    print(f"| refused | {len(refused)} |")


if __name__ == "__main__":
    main()
