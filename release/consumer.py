"""What a program that uses the package writes: `mypy --strict` has to know all of its types."""

from __future__ import annotations

import torch

import raden_torch as rt


def light_a_frame(path: str, normal: torch.Tensor) -> torch.Tensor:
    """Fit a measurement, and light normals `[B, 3, H, W]` with it."""
    measurement: rt.BrdfMeasurement = rt.load_measurement(path)
    result = rt.fit(measurement, interpolation="trilinear")
    model: rt.RadenBrdf = result.model
    readings: int = len(measurement)
    frame = rt.GBuffer(normal, view=(0.0, 0.0, 1.0))
    lamp, bulb = rt.DirectionalLight((1.0, 1.0, 2.0)), rt.PointLight((0.0, 0.0, 3.0))
    image: torch.Tensor = rt.shade(model, frame, [lamp, bulb])
    lit, std = rt.shade(model, frame, lamp, return_std=True)
    image = image + lit + std.total
    incidence, receiving, tilt = rt.raden_angles(normal, normal, normal)
    rt.save_model(model, "shell.safetensors")
    return image * float(readings) + incidence + receiving + tilt


def mistaken(model: rt.RadenBrdf) -> None:
    """Rationale: if types were not seen, these would pass; `--strict` reports unused ignores."""
    rt.fit("shell.csv")  # type: ignore[arg-type]
    rt.shade(model, model, [])  # type: ignore[call-overload]
    rt.load_measurement(3)  # type: ignore[arg-type]
