"""Measure how mother-of-pearl inlay (raden) reflects, keep it as a model, light images with it.

The public names are imported when they are first used, so that `import raden_torch` costs no more
than the standard library, and code that needs no torch loads none.
"""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOMES = {
    "BrdfMeasurement": "raden_torch.measurement",
    "DirectionalLight": "raden_torch.brdf.shading.lights",
    "FrameDataset": "raden_torch.sequences.dataset",
    "GBuffer": "raden_torch.brdf.shading.gbuffer",
    "PointLight": "raden_torch.brdf.shading.lights",
    "RadenBrdf": "raden_torch.brdf.model.model",
    "SpotLight": "raden_torch.brdf.shading.lights",
    "export_onnx": "raden_torch.export.export",
    "fit": "raden_torch.brdf.fitting.fit",
    "load_measurement": "raden_torch.capture.exchange",
    "load_model": "raden_torch.brdf.files.model_file",
    "raden_angles": "raden_torch.geometry",
    "save_model": "raden_torch.brdf.files.model_file",
    "shade": "raden_torch.brdf.shading.shade",
    "simulate_specimen": "raden_torch.optics",
    "vectors_from_angles": "raden_torch.geometry",
}

__all__ = [
    "BrdfMeasurement",
    "DirectionalLight",
    "FrameDataset",
    "GBuffer",
    "PointLight",
    "RadenBrdf",
    "SpotLight",
    "export_onnx",
    "fit",
    "load_measurement",
    "load_model",
    "raden_angles",
    "save_model",
    "shade",
    "simulate_specimen",
    "vectors_from_angles",
]

if TYPE_CHECKING:
    from raden_torch.brdf.files.model_file import load_model, save_model
    from raden_torch.brdf.fitting.fit import fit
    from raden_torch.brdf.model.model import RadenBrdf
    from raden_torch.brdf.shading.gbuffer import GBuffer
    from raden_torch.brdf.shading.lights import DirectionalLight, PointLight, SpotLight
    from raden_torch.brdf.shading.shade import shade
    from raden_torch.capture.exchange import load_measurement
    from raden_torch.export.export import export_onnx
    from raden_torch.geometry import raden_angles, vectors_from_angles
    from raden_torch.measurement import BrdfMeasurement
    from raden_torch.optics import simulate_specimen
    from raden_torch.sequences.dataset import FrameDataset


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'raden_torch' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _show_models_in_notebooks() -> None:
    """Under IPython a model that a cell ends with is shown in the viewer (decision 35)."""
    ipython = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if ipython is not None:
        formatter = ipython.display_formatter.formatters["text/html"]
        formatter.for_type_by_name("raden_torch.brdf.model.model", "RadenBrdf", _viewer_frame)


def _viewer_frame(model: Any) -> str | None:
    from raden_torch.export.notebook import viewer_frame

    return viewer_frame(model)


_show_models_in_notebooks()
