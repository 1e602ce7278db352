"""The two forms of a model that can be exported, each a function of unit vectors and of angles.

Their eager code is torch's picture, which a file is checked against. What is in their `state_dict`
becomes inputs of the graph.
"""

from __future__ import annotations

import copy
from typing import Any

import torch
from torch import Tensor, nn

from raden_torch import geometry
from raden_torch.brdf.files.model_file import assemble
from raden_torch.brdf.model.model import RadenBrdf, equation_2
from raden_torch.brdf.model.runtime_table import RuntimeLayout, address_of_angles, read, read_at
from raden_torch.errors import InputError

FORMS = ("runtime", "fit")
GAINS = ("diffuse_gain", "specular_gain")


class RuntimeForm(nn.Module):
    """The table over the whole hemisphere that a model is read through: `table`, `[U, V, W, 3]`."""

    table: Tensor

    def __init__(self, table: Tensor, layout: RuntimeLayout) -> None:
        super().__init__()
        wanted = [*layout.shape, 3]
        if list(table.shape) != wanted:
            raise InputError(f"table: expected shape {wanted}, got {list(table.shape)}")
        self.register_buffer("table", table)
        self.warp = layout.warp

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """f_r `[B, 3, H, W]` in 1/sr, as `RadenBrdf.of_unit_vectors`."""
        return read(self.table.to(n.dtype), self.warp, n, l, v)

    def at_angles(self, incidence: Tensor, receiving: Tensor, tilt: Tensor) -> Tensor:
        """f_r by angles, as `RadenBrdf.at_angles`."""
        values = self.table.to(incidence.dtype)
        return read_at(values, *address_of_angles(self.warp, incidence, receiving, tilt))

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        """float64 where a map or the table is, else float32."""
        return geometry.working_dtype(*maps, self.table)


class FitForm(nn.Module):
    """The paper's form, eq. (2), with its table, diffuse parameters and gains."""

    diffuse_gain: Tensor
    specular_gain: Tensor

    def __init__(self, model: RadenBrdf) -> None:
        super().__init__()
        self.diffuse, self.table = model.diffuse, model.table
        for gain, part in zip(GAINS, (model.diffuse, model.table), strict=True):
            if part is not None:
                self.register_buffer(gain, torch.as_tensor(float(getattr(model, gain))))

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """f_r `[B, 3, H, W]` in 1/sr, 0 below the horizon."""
        f = self.at_angles(*geometry.angles_from_unit_vectors(n, l, v))
        above = (geometry.dot(n, l) > 0) & (geometry.dot(n, v) > 0)
        return torch.where(above, f, torch.zeros_like(f))

    def at_angles(self, incidence: Tensor, receiving: Tensor, tilt: Tensor) -> Tensor:
        """f_r by angles, as `RadenBrdf.fit_form`."""
        body, specular = (getattr(self, gain, 1.0) for gain in GAINS)
        return equation_2(self.diffuse, self.table, body, specular, incidence, receiving, tilt)

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        """float64 where a map or the model is, else float32."""
        return geometry.working_dtype(*maps, *self.parameters())


Form = RuntimeForm | FitForm


def form_of(model: RadenBrdf, name: str) -> Form:
    """A model's form by name, in float32, without gradients.

    Raises:
        InputError: no such form.
    """
    if name not in FORMS:
        raise InputError(f"form: expected one of {', '.join(FORMS)}, got {name!r}")
    own = copy.deepcopy(model).float().requires_grad_(False).eval()
    if name == "fit":
        return FitForm(own)
    return RuntimeForm(own.runtime_table().clone(), own.layout)


def form_from(name: str, about: dict[str, Any], tensors: dict[str, Tensor]) -> Form:
    """A form again, from what `model_file.describe` says of the model, and its own `state_dict`.

    Raises:
        InputError, KeyError, TypeError, ValueError: the two do not make one.
    """
    if name == "runtime":
        u, v, w = (int(n) for n in about["runtime"]["shape"])
        c, k = (float(x) for x in about["runtime"]["warp"])
        return RuntimeForm(tensors["table"], RuntimeLayout((u, v, w), (c, k)))
    gains = {gain: float(tensors.pop(gain)) for gain in GAINS if gain in tensors}
    return form_of(assemble(about | gains, tensors), name)
