"""Learn the weights of `raden_torch/reflectance/continuation.json`, and say how good they are.

Truth: real materials on the raden grid and in 12,000 other directions each (`whole_hemisphere`).
The boxes are the measured one and two smaller ones in it; what lies in a box is read by the
library's own interpolators. The weights minimise the mean absolute error of log(ε + Y) and a ridge,
by reweighted least squares. `--leave-one-out` writes nothing: it learns without each material in
turn and scores on that one, the numbers of `docs/decisions/0017-outside-the-box.md`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import raden_torch as rt
from raden_torch.arrays import Floats
from raden_torch.files import written_beside
from raden_torch.reflectance import continuation
from raden_torch.reflectance.continuation import FLOOR, Look, faces, look_into
from raden_torch.reflectance.interpolation import interpolate
from raden_torch.reflectance.scheme_choice import best, hold_out_losses

DATA = Path(__file__).resolve().parents[2] / "shared/data/whole_hemisphere"
WEIGHTS = Path(continuation.__file__).with_suffix(".json")
SOURCE = "learnt by benchmarks/learn_continuation.py from {} real materials: {}"
BOXES = {70: 1.0, 60: 0.3, 50: 0.15}
"""Half a box's width in degrees, and how much its errors count."""
POINTS = 1500  # of a material and a box
RIDGE_BOXES = {65: 2.0, 60: 2.0, 50: 0.6}
"""The same of the mirror ridge: the grid's own nodes outside these boxes, on and beside it."""
RIDGE_WIDTH_DEG = 8.0  # of the half vector from the normal
NOISE = 0.01  # of the logarithm: what readings may err
RIDGE = 0.003
SMALL = 0.02  # errors of the logarithm below this count quadratically
ROUNDS = 8
DIGITS = 4
_LOG = "mean |dlog(1+Y)|"


@dataclass(frozen=True)
class Sample:
    """Geometries outside one box of one material, and the equations for the weights there.

    Attributes:
        ridge: they are nodes on the mirror ridge or beside it.
        count: how much each error counts.
        design: `[M, weights]`: what each weight is multiplied with, with noisy readings.
        truth, held: `[M]`: log(ε + Y) there, and at the nearest geometry in the box.
    """

    material: str
    box: int
    ridge: bool
    count: float
    angles_deg: Floats
    design: Floats
    truth: Floats
    held: Floats


def samples(material: str) -> Iterator[Sample]:
    """Of every box, and of the mirror ridge outside every box."""
    grid = rt.load_measurement(DATA / f"{material}.csv").grid()
    test = rt.load_measurement(DATA / f"{material}.hemisphere.csv")
    q = test.angles_deg
    losses = hold_out_losses(grid.axes_deg, grid.values, np.ones(grid.values.shape[:3], bool))
    known = interpolate(grid.axes_deg, grid.values, best(losses))

    def between(angles_deg: Floats) -> Floats:
        return np.log(FLOOR + known(angles_deg, slice(1, 2)))

    truth = np.log(FLOOR + np.maximum(test.values[:, 1], 0))
    for box, count in BOXES.items():
        outside = (abs(q) > box).any(axis=1)
        yield _sample(material, box, False, count, q[outside], truth[outside], between)
    logs = np.log(FLOOR + np.maximum(grid.values[..., 1:2], 0))
    nodes = grid.axes_deg.nodes_deg()
    at_nodes = look_into(grid.axes_deg, logs)
    for box, count in RIDGE_BOXES.items():
        there = (abs(nodes) > box).any(axis=3) & (half_angle_deg(nodes) < RIDGE_WIDTH_DEG)
        yield _sample(material, box, True, count, nodes[there], logs[there][:, 0], at_nodes)


def _sample(
    material: str, box: int, ridge: bool, count: float, q: Floats, truth: Floats, known: Look
) -> Sample:
    low_high = np.array([[0.0, -box, -box], [box, box, box]])
    rng = np.random.default_rng(box)

    def look(angles_deg: Floats) -> Floats:
        turn = np.where(angles_deg[:, :1] < 0, -1.0, 1.0)
        return known(np.clip(angles_deg * turn, *low_high))

    def noisy(angles_deg: Floats) -> Floats:
        clean = look(angles_deg)
        return clean + NOISE * rng.standard_normal(clean.shape)

    products = np.concatenate(list(_products(noisy, q, low_high).values()), axis=1)
    return Sample(material, box, ridge, count, q, products, truth, look(q)[:, 0])


def half_angle_deg(angles_deg: Floats) -> Floats:
    """Between the half vector and the normal."""
    a, r, t = np.moveaxis(np.deg2rad(angles_deg), -1, 0)
    return np.asarray(np.rad2deg(np.arccos(np.clip(np.cos((a - r) / 2) * np.cos(t), -1, 1))))


def _products(look: Look, angles_deg: Floats, low_high: Floats) -> dict[str, Floats]:
    """By kind of face `[M, K · J]`: each difference times each function of the basis."""
    found: dict[str, Floats] = {}
    for face in faces(look, angles_deg, low_high):
        each = face.differences[:, :, 0, None] * face.basis[:, None, :]
        found[face.kind] = found.get(face.kind, 0) + each.reshape(len(each), -1)
    return found


def learn(known: list[Sample]) -> Floats:
    """All weights in a row."""
    rng = np.random.default_rng(0)
    designs, changes, counts = [], [], []
    for sample in known:
        some = rng.permutation(len(sample.truth))[:POINTS]
        designs.append(sample.design[some])
        changes.append((sample.truth - sample.held)[some])
        counts.append(np.full(len(some), sample.count))
    design, change, count = (np.concatenate(x) for x in (designs, changes, counts))
    scale = np.sqrt((design**2).mean(axis=0))
    design = design / scale
    ridge = RIDGE * count.sum() * np.eye(len(scale))
    weight, found = count, scale
    for _ in range(ROUNDS):
        normal = design.T @ (design * weight[:, None]) + ridge
        found = np.linalg.solve(normal, design.T @ (weight * change))
        weight = count / np.maximum(abs(change - design @ found), SMALL)
    return np.asarray(found / scale)


def by_kind(weights: Floats) -> dict[str, Floats]:
    """`[K, J]` each, as `continuation.learnt_weights` gives them."""
    q = np.array([[75.0, 75.0, 75.0]])
    kinds = faces(lambda p: np.zeros((len(p), 1)), q, np.array([[0.0, -70, -70], [70, 70, 70]]))
    found, start = {}, 0
    for face in (kinds[0], kinds[2]):
        shape = face.differences.shape[1], face.basis.shape[1]
        size = shape[0] * shape[1]
        found[face.kind] = weights[start : start + size].reshape(shape)
        start += size
    return found


def write(weights: Floats, materials: list[str]) -> None:
    rounded = {
        kind: [[float(f"{w:.{DIGITS}g}") for w in row] for row in rows]
        for kind, rows in by_kind(weights).items()
    }
    text = {"source": SOURCE.format(len(materials), ", ".join(materials)), "weights": rounded}
    with written_beside(WEIGHTS) as path:
        path.write_text(json.dumps(text, indent=1).replace("\n   ", " ") + "\n")


def report(scored: list[tuple[Sample, Floats]]) -> None:
    """Print, for each box, the medians over the materials."""
    for ridge, boxes in ((False, BOXES), (True, RIDGE_BOXES)):
        for box in boxes:
            of_box = [(s, change) for s, change in scored if (s.ridge, s.box) == (ridge, box)]
            where = f"nodes within {RIDGE_WIDTH_DEG:g} deg of the mirror" if ridge else "all"
            print(f"box {box}, {where}: median over {len(of_box)} materials (held edge); worst")
            lines = [_scores(s, s.held + change) for s, change in of_box]
            held = [_scores(s, s.held) for s, _ in of_box]
            for name in lines[0]:
                new, old = (np.array([x[name] for x in rows]) for rows in (lines, held))
                print(f"  {name:26} {np.median(new):.4f} ({np.median(old):.4f}); {new.max():.3f}")
            ratio = [x[_LOG] / y[_LOG] for x, y in zip(lines, held, strict=True)]
            print(f"  its ratio to the held edge {np.median(ratio):.3f}; {max(ratio):.3f}")


def _scores(sample: Sample, logs: Floats) -> dict[str, float]:
    found, truth = (np.maximum(np.exp(x) - FLOOR, 0) for x in (logs, sample.truth))
    relative = abs(found - truth) / np.maximum(truth, FLOOR)
    groups = {"median relative error": np.ones(len(truth), bool)}
    half = half_angle_deg(sample.angles_deg)
    if sample.ridge:
        groups["on the ridge"] = half < 1
    else:
        beyond = np.maximum(abs(sample.angles_deg) - sample.box, 0)
        quarter = (80 - sample.box) / 4
        groups |= {"half angle < 25": half < 25, "half angle > 25": half >= 25}
        groups["beyond the tilt"] = beyond[:, 2] > 0
        for low in quarter * np.arange(4):
            there = (beyond.max(axis=1) > low) & (beyond.max(axis=1) <= low + quarter)
            groups[f"beyond by {low:g} to {low + quarter:g}"] = there
    scores = {name: float(np.median(relative[there])) for name, there in groups.items()}
    return scores | {_LOG: float(np.mean(abs(np.log1p(found) - np.log1p(truth))))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--leave-one-out", action="store_true")
    wanted = parser.parse_args().leave_one_out
    files = sorted(DATA.glob("*.hemisphere.csv"))
    materials = [file.name.removesuffix(".hemisphere.csv") for file in files]
    known = [sample for material in materials for sample in samples(material)]
    if not wanted:
        write(learn(known), materials)
        return
    scored = []
    for material in materials:
        weights = learn([sample for sample in known if sample.material != material])
        scored += [(s, s.design @ weights) for s in known if s.material == material]
    report(scored)


if __name__ == "__main__":
    main()
