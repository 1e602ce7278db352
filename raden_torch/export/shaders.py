"""The modules that are traced: a form of the model between named inputs and one output."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn

from raden_torch import geometry
from raden_torch.export.forms import FitForm, Form, PaletteForm
from raden_torch.export.palette_graph import PaletteGraph
from raden_torch.export.profiles import GraphInput
from raden_torch.export.runtime_graph import RuntimeGraph, dot


class Shader(nn.Module):
    """A profile over a form: tensors in the order of the ports → `[B, 3, H, W]`.

    The form's parameters arrive as inputs too, so that the exporter folds none of them away.
    """

    def __init__(self, form: Form, profile: str, output: str, ports: list[GraphInput]) -> None:
        super().__init__()
        self.ports = ports
        own = copy.deepcopy(form)
        reflection: nn.Module = (
            EagerGraph(own)
            if isinstance(own, FitForm)
            else PaletteGraph(own)
            if isinstance(own, PaletteForm)
            else RuntimeGraph(own)
        )
        scene = profile == "scene"
        self.inner = SceneShading(reflection) if scene else GBufferShading(reflection, output)

    def forward(self, *tensors: Tensor) -> Tensor:
        given = {port.name: t for port, t in zip(self.ports, tensors, strict=True)}
        parameters = {
            f"reflection.form.{port.parameter}": given.pop(port.name)
            for port in self.ports
            if port.parameter is not None
        }
        return torch.func.functional_call(self.inner, parameters, (given,), strict=False)


class EagerGraph(nn.Module):
    """A form's own eager code, of vectors of any length; as `RuntimeGraph`."""

    def __init__(self, form: FitForm) -> None:
        super().__init__()
        self.form = form

    def forward(self, normal: Tensor, light: Tensor, view: Tensor) -> tuple[Tensor, ...]:
        n, l, v = (geometry.normalised(m) for m in (normal, light, view))  # noqa: E741
        n_l, n_v = geometry.dot(n, l), geometry.dot(n, v)
        f = self.form.at_angles(*geometry.angles_from_unit_vectors(n, l, v))
        return f, n_l, torch.minimum(n_l, n_v)


class GBufferShading(nn.Module):
    """f_r, or the radiance under one light, of a G-buffer of unit or other vectors."""

    def __init__(self, reflection: nn.Module, output: str) -> None:
        super().__init__()
        self.reflection = reflection
        self.output = output

    def forward(self, given: dict[str, Tensor]) -> Tensor:
        vectors = (given[name] for name in ("normal", "light", "view"))
        f, cosine, shows = self.reflection(*vectors, *_material(given))
        mask = torch.relu(given["mask"])
        factor = mask.clamp(max=1)
        if self.output == "radiance":
            factor = cosine * factor * (given["irradiance"] * given["exposure"])
        return _lit(f * factor, shows * mask)


class SceneShading(nn.Module):
    """The radiance of a G-buffer under K lights: `[K, 4]` directions or positions, as in `ports`.

    The lights are a dimension of their own, `[B, K, 3, H, W]`, so that K is free.
    """

    def __init__(self, reflection: nn.Module) -> None:
        super().__init__()
        self.reflection = reflection

    def forward(self, given: dict[str, Tensor]) -> Tensor:
        position = given["position"].unsqueeze(1)
        camera = given["camera"][:, None, :, None, None]
        placed, colour = (given[name][None, :, :, None, None] for name in ("light", "light_colour"))
        near = (placed[:, :, 3:] > 0).float()
        to_light = placed[:, :, :3] - near * position
        f, cosine, shows = self.reflection(
            given["normal"].unsqueeze(1),
            to_light,
            camera - position,
            *(material.unsqueeze(1) for material in _material(given)),
        )
        distance_squared = near * dot(to_light, to_light) + (1 - near)
        image = f * (cosine / distance_squared) * (colour * given["exposure"])
        return _lit(image, shows).sum(1) * _share(given["mask"])


def _material(given: dict[str, Tensor]) -> list[Tensor]:
    """The map that chooses of a palette, where there is one."""
    return [given[name] for name in ("material", "weights") if name in given]


def _lit(image: Tensor, shows: Tensor) -> Tensor:
    """0 unless `shows` is above 0, and where it is NaN.

    One condition a pixel: one for each channel would take three times as long. It is written with
    `Less`, since OpenVINO's `Greater` is true for NaN.
    """
    zero = torch.zeros(())
    return torch.where(zero < shows, image, zero)


def _share(mask: Tensor) -> Tensor:
    """Within 0…1; NaN counts as 0."""
    return torch.where(mask > 0, mask, torch.zeros(())).clamp(max=1)
