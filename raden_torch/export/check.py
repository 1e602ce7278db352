"""Does a runtime give torch's picture? The stress set, region by region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import torch
from torch import Tensor

from raden_torch.export.expected import REGIONS, Expected, expected
from raden_torch.export.forms import Form
from raden_torch.export.runtimes import Runtime, SkippedRuntime, one_line
from raden_torch.export.stress_inputs import cases

LIMITS = {
    "general": 5e-6,
    "steep": 5e-5,
    "L near V": 5e-5,
    "any length": 2e-5,
    "L parallel to V": 5e-5,
    "not vectors": 0.0,
}
"""The largest difference allowed, as a share of the stress set's peak."""

_ROUNDING_SHOWS = 0.1
"""Where |L × V| is below this, vectors of any length may differ by its inverse more."""


@dataclass(frozen=True)
class RegionResult:
    """How many pixels of a region were compared, and the largest difference over the peak."""

    pixels: int = 0
    largest: float = 0.0


@dataclass(frozen=True)
class RuntimeResult:
    """What one runtime did.

    Attributes:
        status: "same picture", "differs" or "skipped".
        reason: why it was skipped, or which cases it cannot run.
        regions: by region of `LIMITS`.
    """

    name: str
    version: str = ""
    status: str = "skipped"
    reason: str = ""
    regions: dict[str, RegionResult] = field(default_factory=dict)


@dataclass(frozen=True)
class ExportReport:
    """An exported file and how it did against torch.

    Attributes:
        form, profile, output: what was exported.
        opset, ir_version, nodes: of the graph.
        bytes: of the file; 0 in the copy inside the file.
        torch: the version compared with.
        peak: the largest value in the stress set, to which differences are compared.
        runtimes: one entry a runtime; the first is ONNX Runtime.
    """

    form: str
    profile: str
    output: str
    opset: int
    ir_version: int
    nodes: int
    bytes: int
    torch: str
    peak: float
    runtimes: tuple[RuntimeResult, ...]

    @property
    def failures(self) -> list[str]:
        """One line for each runtime that gives another picture."""
        return [_failure(r) for r in self.runtimes if r.status == "differs"]

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        return asdict(self)

    def __str__(self) -> str:
        lines = [
            f"{self.form} form, {self.profile} profile, output {self.output}: {self.bytes} bytes, "
            f"{self.nodes} nodes, opset {self.opset}, IR {self.ir_version}",
            f"compared with torch {self.torch}; differences as shares of the peak {self.peak:.4g}",
        ]
        for r in self.runtimes:
            lines.append(f"{r.name} {r.version}: {r.status}".replace(" :", ":"))
            lines[-1] += f" ({r.reason})" if r.reason else ""
            lines += [
                f"  {name}: {region.pixels} pixels, at most {region.largest:.1e} "
                f"(allowed {LIMITS[name]:.0e})"
                for name, region in r.regions.items()
            ]
        return "\n".join(lines)


class StressSet:
    """The inputs of a profile and torch's pictures of them."""

    def __init__(self, form: Form, profile: str, output: str, *, fixed: bool = False) -> None:
        self.cases = cases(form, profile, output, fixed=fixed)
        self.expected = [expected(form, profile, output, case.inputs) for case in self.cases]
        largest = [float(e.values.abs().max()) for e in self.expected if e.values.numel()]
        self.peak = max([*largest, torch.finfo(torch.float32).tiny])

    def run(self, runtime: Runtime | SkippedRuntime) -> RuntimeResult:
        """Compare one runtime with torch."""
        if isinstance(runtime, SkippedRuntime):
            return RuntimeResult(runtime.name, reason=runtime.reason)
        regions = {name: RegionResult() for name in REGIONS}
        left_out: list[str] = []
        for case, wanted in zip(self.cases, self.expected, strict=True):
            if not (runtime.takes_all or case.is_basic):
                left_out.append(case.name)
                continue
            try:
                output = runtime.run({k: v.contiguous().numpy() for k, v in case.inputs.items()})
            except Exception as error:  # whatever a foreign runtime raises is its reason
                # ONNX Runtime 1.18 refuses some products where there are no pixels or lights
                if runtime.takes_all and all(t.numel() for t in case.inputs.values()):
                    raise
                left_out.append(f"{case.name} ({one_line(error)})")
                continue
            _add(regions, torch.from_numpy(output), wanted, self.peak)
        return _result(runtime, regions, left_out)


def _add(regions: dict[str, RegionResult], output: Tensor, wanted: Expected, peak: float) -> None:
    """Compare one picture and keep the largest difference of each region."""
    if output.shape != wanted.values.shape[1:]:
        difference = torch.full_like(wanted.values[0, :, :1], torch.inf)
    else:
        difference = (output - wanted.values).abs().amin(0).amax(1, keepdim=True)
        difference = torch.where(torch.isfinite(difference), difference, torch.inf)
        difference = (difference - wanted.rounding).clamp(min=0) / peak
        scale = (wanted.sine / _ROUNDING_SHOWS).clamp(max=1)
        scaled = wanted.region == REGIONS.index("any length")
        difference = torch.where(scaled, difference * scale, difference)
    region = wanted.regions(peak)
    for index, name in enumerate(REGIONS):
        here = difference[region == index]
        if here.numel():
            old = regions[name]
            largest = max(old.largest, float(here.max()))
            regions[name] = RegionResult(old.pixels + here.numel(), largest)


def _result(
    runtime: Runtime, regions: dict[str, RegionResult], left_out: Sequence[str]
) -> RuntimeResult:
    compared = {name: region for name, region in regions.items() if region.pixels}
    reason = f"not run: {', '.join(left_out)}" if left_out else ""
    if not compared:
        return RuntimeResult(runtime.name, runtime.version, "skipped", reason)
    same = all(region.largest <= LIMITS[name] for name, region in compared.items())
    status = "same picture" if same else "differs"
    return RuntimeResult(runtime.name, runtime.version, status, reason, compared)


def _failure(result: RuntimeResult) -> str:
    worst = max(result.regions, key=lambda name: result.regions[name].largest - LIMITS[name])
    return (
        f"{result.name} {result.version}: expected an image within {LIMITS[worst]:.0e} of the "
        f"peak, got one off by {result.regions[worst].largest:.1e} ({worst})"
    )
