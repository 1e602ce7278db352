"""How often `raden analyse` is right: tablets of simulated shells, and what its intervals cover.

    python benchmarks/tablets.py [--shells literature|same|ends] [--repeats 100] [--seed 7]
        [--first 0] [--calibrate] [--out DIR]

Each repeat is a shell of its own, X, Y, Z and bands by turns, of which the fit is told nothing:

- literature: tablets of 260 to 540 nm, spread 2.5 to 9 %, 80 to 200 of them; organic sheets of
  25 ± 5 nm, of index 1.40 to 1.57, spread 10 to 30 %; dispersion of the tablets 0.5 to 1.5 times
  calcite's; k 2e-4 to 1e-3 (ranges of optics/nacre.py); layers that lean by 0 to 10 degrees; 30 to
  90 random stacks in a spot; 0.5 to 4 % noise;
- same: the fit's own optics, spread 3 to 8 %, 60 stacks, 2 % noise, layers at 7.5 degrees;
- ends: other shells (akoya, abalone, mexican, their planes and bodies) and the ends of these
  ranges only: sheets of 18 or 32 nm and index 1.42 or 1.56, k 2e-4 or 1e-3, 80 or 200 tablets.

`optics/tablet_fit.py` has its errors beyond the noise from literature shells of seed 2026, of the
repeats that are 0 or 1 modulo 4 (`--seed 2026 --calibrate --repeats 72`); the repeats that are 2 or
3 modulo 4, other seeds and the ends test it. Prints the table of docs/accuracy.md and writes
tablets_SHELLS_SEED.json. 100 repeats take some four minutes.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import beta, t

from raden_torch.errors import InputError
from raden_torch.measurement.readings import XYZ, BrdfMeasurement
from raden_torch.optics.nacre import Stack
from raden_torch.optics.shell import BANDS_NM, Specimen
from raden_torch.optics.specimens import SPECIMENS, reflectance_factors
from raden_torch.optics.tablet_fit import (
    PERIOD_MODEL_STD,
    SPREAD_MODEL_STD,
    TabletEstimate,
    estimate_tablets,
)

RIDGE_DEG = np.array([(a, a, t) for a in np.arange(0, 71, 5.0) for t in (-10, -5, 0, 5, 10)])


def shell_of(repeat: int, seed: int, shells: str) -> tuple[Specimen, float]:
    """A shell, and the relative noise of its readings."""
    rng = np.random.default_rng((seed, repeat))
    base, count, noise = SPECIMENS["yakogai"], 60, 0.02
    if shells == "same":
        stack = Stack(rng.uniform(300, 520), rng.uniform(0.03, 0.08), max(8.0, rng.normal(25, 5)))
    elif shells == "literature":
        stack = Stack(
            rng.uniform(260, 540),
            rng.uniform(0.025, 0.09),
            organic_nm=max(8.0, rng.normal(25, 5)),
            organic_spread=rng.uniform(0.1, 0.3),
            tablets=int(rng.integers(80, 201)),
            loss=10 ** rng.uniform(-3.7, -3),
            organic_n=rng.uniform(1.40, 1.57),
            dispersion=rng.uniform(0.5, 1.5),
        )
        leaning = np.tan(np.radians(rng.uniform(0, 10)))
        facets = tuple(f._replace(mean_slope=leaning) for f in base.facets[:2])
        base = replace(base, facets=(*facets, base.facets[2]), body_albedo=rng.uniform(0.2, 0.6))
        count, noise = int(rng.integers(30, 91)), rng.uniform(0.005, 0.04)
    else:
        base = SPECIMENS[str(rng.choice(["akoya", "abalone", "mexican"]))]
        stack = Stack(
            rng.uniform(260, 540),
            rng.uniform(0.025, 0.09),
            organic_nm=rng.choice([18.0, 32.0]),
            organic_spread=rng.choice([0.1, 0.3]),
            tablets=int(rng.choice([80, 200])),
            loss=rng.choice([2e-4, 1e-3]),
            organic_n=rng.choice([1.42, 1.56]),
            dispersion=rng.choice([0.5, 1.5]),
        )
        noise = 0.03
    drawn = int(rng.integers(1 << 30))
    shell = replace(base, stack=stack, steep_tablet_nm=stack.tablet_nm)
    return replace(shell, stacks=count, stack_seed=drawn), noise


def readings_of(shell: Specimen, noise: float, repeat: int) -> BrdfMeasurement:
    spectral = bool(repeat % 2)
    values = reflectance_factors(shell, RIDGE_DEG, spectral=spectral)
    std = noise * np.maximum(values, 1)
    values = values + std * np.random.default_rng(repeat).standard_normal(values.shape)
    channels = tuple(f"{band:g}nm" for band in BANDS_NM) if spectral else XYZ
    return BrdfMeasurement(*RIDGE_DEG.T, values=values, channels=channels, std=std)


def row_of(stack: Stack, found: TabletEstimate, spectral: bool) -> dict[str, Any]:
    low, high = found.tablet_interval_nm
    s_low, s_high = found.spread_interval
    period = stack.tablet_nm + stack.organic_nm
    return {
        "truth": asdict(stack),
        "found": asdict(found),
        "spectral": spectral,
        "within 3 %": bool(abs(found.tablet_nm / stack.tablet_nm - 1) < 0.03),
        "thickness covered": bool(low <= stack.tablet_nm <= high),
        "period covered": bool(abs(found.period_nm - period) <= 1.96 * found.period_std_nm),
        "spread covered": bool(s_low <= stack.tablet_spread <= s_high),
        "order": bool(abs(found.tablet_nm / stack.tablet_nm - 1) < 0.1),
        "period error, nm": found.period_nm - period,
        "log spread error": float(np.log(found.spread / stack.tablet_spread)),
    }


def interval(hits: int, of: int) -> str:
    """Clopper and Pearson's 95 % interval of a share, in percent."""
    low = beta.ppf(0.025, hits, of - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, of - hits) if hits < of else 1.0
    return f"{hits} of {of} ({100 * hits / of:.0f} %, {100 * low:.0f}…{100 * high:.0f})"


def beyond_noise(rows: list[dict[str, Any]]) -> tuple[float, float]:
    """Relative standard deviations of the period, and of the spread, beyond noise and sheets: by
    maximum likelihood, times what Student's t has more than the normal distribution."""
    right = [row for row in rows if row["order"]]
    found = {k: np.array([row["found"][k] for row in right]) for k in right[0]["found"]
             if k != "others_nm"}  # fmt: skip
    period = np.array([row["period error, nm"] for row in right])
    spread = np.array([row["log spread error"] for row in right])
    tablet = found["tablet_nm"]
    noise = found["period_std_nm"] ** 2 - (PERIOD_MODEL_STD * tablet) ** 2  # and sheets
    spread_noise = found["spread_std"] ** 2 - SPREAD_MODEL_STD**2
    more = t.ppf(0.975, len(right) - 1) * np.sqrt(1 + 1 / len(right)) / 1.96

    def most_likely(error: Any, known: Any, scale: Any) -> float:
        def minus(log_std: float) -> float:
            variance = np.maximum(known, 0) + (np.exp(log_std) * scale) ** 2
            return float(np.sum(np.log(variance) + error**2 / variance))

        return float(np.exp(minimize_scalar(minus, bounds=(-9, -2), method="bounded").x) * more)

    return (
        most_likely(period, noise, tablet),
        most_likely(spread * found["spread"], spread_noise, np.ones(len(right))),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--first", type=int, default=0, help="the first repeat")
    parser.add_argument("--calibrate", action="store_true")
    parser.add_argument("--shells", choices=["literature", "same", "ends"], default="literature")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    given = parser.parse_args()
    rows, refused = [], []
    wanted = range(given.first, given.first + given.repeats)
    for repeat in (r for r in wanted if not given.calibrate or r % 4 < 2):
        shell, noise = shell_of(repeat, given.seed, given.shells)
        try:
            found = estimate_tablets(readings_of(shell, noise, repeat))
            row = row_of(shell.stack, found, bool(repeat % 2))
            rows.append(row | {"noise": noise, "repeat": repeat})
        except InputError as error:
            refused.append({"truth": asdict(shell.stack), "said": str(error)})
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / f"tablets_{given.shells}_{given.seed}.json"
    path.write_text(json.dumps({"seed": given.seed, "rows": rows, "refused": refused}, indent=1))
    if given.calibrate:
        print("period and spread beyond the noise: {:.5f}, {:.5f}".format(*beyond_noise(rows)))
    print(f"| {given.shells} shells, seed {given.seed} | of {given.repeats} |\n|---|---|")
    for name in ("within 3 %", "thickness covered", "period covered", "spread covered"):
        print(f"| {name} | {interval(sum(row[name] for row in rows), len(rows))} |")
    right = [row for row in rows if row["order"]]
    period, spread = (
        np.array([r[k] for r in right]) for k in ("period error, nm", "log spread error")
    )
    print(f"| another order | {len(rows) - len(right)} |")
    print(f"| period: RMS error, nm | {np.sqrt(np.mean(period**2)):.2f} |")
    print(f"| spread: median, RMS error, % | {100 * np.median(spread):.1f}, "
          f"{100 * np.sqrt(np.mean(spread**2)):.1f} |")  # fmt: skip
    print(f"| refused | {len(refused)} |")


if __name__ == "__main__":
    main()
