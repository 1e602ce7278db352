"""A model from a file, as a material that can be shaded."""

from __future__ import annotations

import os

from raden_torch.brdf.files.model_file import load_model
from raden_torch.brdf.materials.spectral import SpectralBrdf
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.errors import InputError


def load_lit(
    path: str | os.PathLike[str], illuminant: str | None = None, white: str | None = None
) -> Reflection:
    """`load_model`, and of a spectral model what it is under an illuminant.

    Args:
        illuminant, white: see `SpectralBrdf.under`; D65 unless stated.

    Raises:
        InputError: either of them with a model in RGB; whatever `load_model` and `under` raise.
    """
    model: Reflection | SpectralBrdf = load_model(path)
    if isinstance(model, SpectralBrdf):
        return model.under(illuminant or "D65", white=white)
    for name, given in (("illuminant", illuminant), ("white", white)):
        if given is not None:
            raise InputError(
                f"{path}: `{name}`: expected with a spectral model, of `raden fit --spectral`, got "
                "a model in RGB"
            )
    return model
