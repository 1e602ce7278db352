"""A plan, out of what a journal's header holds."""

from __future__ import annotations

from typing import Any

from raden_torch.capture.spectrometer.adaptive import AdaptivePlan
from raden_torch.capture.spectrometer.scan_plan import FixedPlan, Plan, cells_from_json
from raden_torch.errors import InputError


def plan_from_json(data: Any) -> Plan:
    """The plan that `as_json` describes.

    Raises:
        InputError: it is not one.
    """
    try:
        kind = data["kind"]
        if kind == "fixed":
            return FixedPlan(**cells_from_json(data))
        if kind == "adaptive":
            return AdaptivePlan.from_json(data)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"plan: {type(error).__name__} {error}; not what a scan wrote") from None
    raise InputError(f"plan: kind: expected fixed or adaptive, got {kind!r}")
