"""Is the standard deviation of a BRDF from photographs right? All of it is simulated.

    python benchmarks/photographic_std.py -o photographic_std.json [--cases …] [--repeats 25]

Series of photographs by the caster in tests/capture/photo/brdf, of a sphere, a plane and a rod,
again and again: in each the lamps stand elsewhere, and everything that the budget states an error
of is off at random by as much as is stated (tests/capture/photo/brdf/repeats.py says what).
`capture_brdf` measures each. By region: the root mean square of error over stated deviation (1 is
right), that ratio's own standard deviation by the scatter between repeats, and the share of errors
within two stated deviations (0.954 of a normal distribution); and in how many repeats a photograph
was said to contradict the others, which none does. `--cases` are names of `repeats.CASES`. A
sphere's repeat takes two seconds of one core, one on the board up to ten.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

from raden_torch.files import written_beside

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.capture.photo.brdf.repeats import CASES, judged, repeated


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("-o", "--output", type=Path, required=True)
    options.add_argument(
        "--cases", nargs="*", default=list(CASES), choices=list(CASES), metavar="NAME"
    )
    options.add_argument("--repeats", type=int, default=25)
    said = options.parse_args()
    rows = []
    for name in said.cases:
        start = time.process_time()
        found, doubted = [], 0
        for seed in range(said.repeats):
            captured = repeated(CASES[name], seed)
            found.append(captured.read)
            doubted += any("contradict" in note for note in captured.notes)
        row = {"simulated": True, "case": name, "repeats": said.repeats}
        row |= {"seconds_each": round((time.process_time() - start) / said.repeats, 1)}
        row |= {"contradictions": doubted}
        rows.append(row | {"regions": judged(found)})
        print(json.dumps(rows[-1]), flush=True)
        with written_beside(said.output) as path:
            path.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
