"""A plan, out of what a journal's header holds."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta, Struct

from raden_torch.capture.spectrometer.adaptive import AdaptivePlan, is_in
from raden_torch.capture.spectrometer.ports import Position
from raden_torch.capture.spectrometer.scan_cells import checked_cells
from raden_torch.capture.spectrometer.scan_plan import MAX_REPEATS, FixedPlan, Plan
from raden_torch.errors import InputError
from raden_torch.schema import Count, Finite, Triple, checked


class _Fixed(Struct):
    name: str
    cells: tuple[Triple, ...]
    repeats: Annotated[int, Meta(ge=1, le=MAX_REPEATS)]
    white_at_each: bool
    excluded: tuple[tuple[Finite, Finite, Finite, str], ...]
    as_given_deg: Finite


class _Adaptive(_Fixed):
    candidates: tuple[Triple, ...]
    budget: Count
    target: Finite | None


def plan_from_json(data: Any) -> Plan:
    """The plan that `as_json` describes.

    Raises:
        InputError: it is not one.
    """
    kind = data.get("kind") if isinstance(data, dict) else data
    if kind not in ("fixed", "adaptive"):
        raise InputError(f"plan: kind: expected fixed or adaptive, got {kind!r:.80}")
    said = checked(data, _Fixed if kind == "fixed" else _Adaptive, "plan")
    known: dict[str, Any] = {
        "name": said.name,
        "cells": checked_cells(said.cells, "plan"),
        "repeats": said.repeats,
        "white_at_each": said.white_at_each,
        "excluded": tuple((Position(*angles), why) for *angles, why in said.excluded),
        "as_given_deg": said.as_given_deg,
    }
    if not isinstance(said, _Adaptive):
        return FixedPlan(**known)
    candidates = checked_cells(said.candidates, "plan: candidates")
    if not is_in(known["cells"], candidates).all():
        raise InputError("plan: expected cells among its candidates, got others")
    return AdaptivePlan(**known, candidates=candidates, budget=said.budget, target=said.target)
