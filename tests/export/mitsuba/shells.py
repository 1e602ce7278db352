"""Shells as they are simulated at the nodes of a small table: no fit, and some seconds less."""

from __future__ import annotations

import numpy as np
import torch

import raden_torch as rt
from raden_torch.brdf.materials.runtime import RuntimeBrdf
from raden_torch.brdf.model.runtime_table import RuntimeLayout, node_angles
from raden_torch.measurement.readings import FACTOR_PER_SR

LAYOUT = RuntimeLayout((16, 25, 25), (0.45, 0.4))


def simulated_shell(name: str) -> RuntimeBrdf:
    angles = torch.stack([a.flatten() for a in node_angles(LAYOUT)], 1).rad2deg().numpy()
    measured = rt.simulate_specimen(name, geometries_deg=angles).as_rgb()
    values = measured.values / FACTOR_PER_SR
    return RuntimeBrdf(torch.from_numpy(values).float().reshape(*LAYOUT.shape, 3), LAYOUT)


def unit(x: float, y: float, z: float) -> list[float]:
    return (np.array([x, y, z]) / np.linalg.norm([x, y, z])).tolist()
