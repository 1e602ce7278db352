"""What would a plan read of a sample that answers at once? Without instruments or a journal."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.scan_plan import Plan
from raden_torch.measurement import BrdfMeasurement


def rehearse(plan: Plan, sample: Callable[[Floats], BrdfMeasurement]) -> Plan:
    """Take every decision of a plan.

    Args:
        sample: reflectance factors at cells `[M, 3]` in degrees; those of the first cells are the
            same whenever it is asked for more.

    Returns:
        The plan at its end: `cells` are what it read, in that order.
    """
    while True:
        decision = plan.decide(len(plan.cells) * plan.per_cell, partial(sample, plan.cells))
        if decision is None:
            return plan
        plan = plan.after(decision)
