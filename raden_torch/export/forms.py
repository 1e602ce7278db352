"""The two forms of a model that can be exported, each a function of unit vectors and of angles.

Their eager code is torch's picture, which a file is checked against. What is in their `state_dict`
becomes inputs of the graph.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, cast

import torch
from torch import Tensor, nn

from raden_torch import geometry
from raden_torch.brdf.files.model_file import assemble, described
from raden_torch.brdf.materials.one_table import one_table
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model.model import RadenBrdf, equation_2
from raden_torch.brdf.model.runtime_table import RuntimeLayout, address_of_angles, read, read_at
from raden_torch.errors import InputError, check_type

FORMS = ("runtime", "fit")
CHOICES = ("index", "weights")
"""How a palette's map says which of its materials a pixel shows."""
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
        self.layout, self.warp = layout, layout.warp

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


class PaletteForm(nn.Module):
    """The runtime tables of a palette's members, of which a map chooses.

    Attributes:
        by: "index" or "weights": what the map holds.
    """

    def __init__(self, members: Sequence[RuntimeForm], by: str) -> None:
        super().__init__()
        self.members = nn.ModuleList(members)
        self.by = by

    @property
    def each(self) -> list[RuntimeForm]:
        """The members."""
        return [cast(RuntimeForm, member) for member in self.members]

    def of_material(self, material: Tensor) -> Mixed:
        """The form with a map: `[B, 1, H, W]` indices, rounded, or `[B, K, H, W]` weights."""
        if self.by == "index":
            numbers = torch.arange(len(self.members), dtype=material.dtype).view(-1, 1, 1)
            material = ((material + 0.5).floor() == numbers).to(material.dtype)
        return Mixed(self, material)


class Mixed(nn.Module):
    """The members of a palette by weights `[B, K, H, W]`."""

    weights: Tensor

    def __init__(self, palette: PaletteForm, weights: Tensor) -> None:
        super().__init__()
        self.each = palette.each
        self.register_buffer("weights", weights)

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """f_r `[B, 3, H, W]` in 1/sr."""
        return self._sum([member.of_unit_vectors(n, l, v) for member in self.each])

    def at_angles(self, incidence: Tensor, receiving: Tensor, tilt: Tensor) -> Tensor:
        """f_r by angles."""
        return self._sum([m.at_angles(incidence, receiving, tilt) for m in self.each])

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        """float64 where a map is, else float32."""
        return geometry.working_dtype(*maps, self.weights)

    def _sum(self, each: list[Tensor]) -> Tensor:
        shares = self.weights.split(1, geometry.XYZ_DIM)
        return torch.stack([f * w for f, w in zip(each, shares, strict=True)]).sum(0)


Form = RuntimeForm | FitForm | PaletteForm


def form_of(model: Reflection, name: str, by: str = "index") -> Form:
    """A model's form by name, in float32, without gradients.

    Args:
        by: of a palette: "index" or "weights".

    Raises:
        InputError: no such form; the fit form of another material than a `RadenBrdf`; a material
            that one table cannot hold.
    """
    if name not in FORMS:
        raise InputError(f"form: expected one of {', '.join(FORMS)}, got {name!r}")
    if by not in CHOICES:
        raise InputError(f"material: expected one of {', '.join(CHOICES)}, got {by!r}")
    if not isinstance(model, RadenBrdf):
        if name == "fit":
            raise InputError(
                "form: expected runtime, the only one of a palette or a coat, got 'fit'"
            )
        if isinstance(model, Palette):
            members = zip(model.names, model, strict=True)
            return PaletteForm([_in_one_table(m, f"palette: {n}") for n, m in members], by)
        return _in_one_table(model, "model")
    own = copy.deepcopy(model).float().requires_grad_(False).eval()
    if name == "fit":
        return FitForm(own)
    return RuntimeForm(own.runtime_table().clone(), own.layout)


def runtime_form(model: RadenBrdf) -> RuntimeForm:
    """The runtime form of a model, for what takes nothing else.

    Raises:
        InputError: it is no `RadenBrdf`.
    """
    check_type("model", model, RadenBrdf, "load_model reads one from a file; fit(…).model is one")
    return cast(RuntimeForm, form_of(model, "runtime"))


def _in_one_table(material: Reflection, where: str) -> RuntimeForm:
    baked = one_table(material, where)
    return RuntimeForm(baked.values.clone(), baked.layout)


def form_from(name: str, about: dict[str, Any], tensors: dict[str, Tensor]) -> Form:
    """A form again, from what `described` says of the model, and its own `state_dict`.

    Raises:
        InputError, KeyError, TypeError, ValueError: the two do not make one.
    """
    if name == "palette":
        members = [
            RuntimeForm(tensors[f"members.{place}.table"], _layout(own))
            for place, own in enumerate(about["members"])
        ]
        if not members or about["by"] not in CHOICES:
            raise InputError("the palette inside is damaged: no members, or no choice of them")
        return PaletteForm(members, about["by"])
    if name == "runtime":
        return RuntimeForm(tensors["table"], _layout(about["runtime"]))
    gains = {gain: float(tensors.pop(gain)) for gain in GAINS if gain in tensors}
    return form_of(assemble(about | gains, tensors), name)


def description(model: Reflection, form: Form) -> dict[str, Any]:
    """What `form_from` needs to know, and what the model is made of, as plain JSON values."""
    about = described(model)[0]
    if isinstance(form, PaletteForm):
        layouts = [asdict(member.layout) for member in form.each]
        return about | {"members": layouts, "by": form.by}
    return about if not isinstance(form, RuntimeForm) else about | {"runtime": asdict(form.layout)}


def _layout(about: dict[str, Any]) -> RuntimeLayout:
    u, v, w = (int(n) for n in about["shape"])
    c, k = (float(x) for x in about["warp"])
    return RuntimeLayout((u, v, w), (c, k))
