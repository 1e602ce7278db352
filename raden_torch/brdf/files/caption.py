"""What a picture has to say of the materials that it shows."""

from __future__ import annotations

from raden_torch.brdf.materials.pearl import PEARL, is_pearl
from raden_torch.brdf.materials.runtime import models_of
from raden_torch.brdf.materials.surface import Reflection


def caption_of(model: Reflection) -> str | None:
    """What a picture of this model, or of these, has to say of itself."""
    simulated = [m.provenance.sample for m in models_of(model) if m.provenance.simulated]
    if is_pearl(model):
        simulated = [PEARL]
    if not simulated:
        return None
    return f"simulated specimen: {', '.join(dict.fromkeys(simulated))}"
