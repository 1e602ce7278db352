"""The modules that are traced: the model's own eager code, between named inputs and one output."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn

from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.export.component_form import PlanarBrdf, unit, xyz
from raden_torch.export.profiles import GAINS, GraphInput


class Shader(nn.Module):
    """A profile over a model: tensors in the order of the ports → `[B, 3, H, W]`.

    The model's parameters arrive as inputs too, so that the exporter folds none of them away.
    """

    def __init__(
        self, model: RadenBrdf, profile: str, output: str, ports: list[GraphInput]
    ) -> None:
        super().__init__()
        self.ports = ports
        own = _with_gains_as_tensors(model)
        self.inner = SceneShading(own) if profile == "scene" else GBufferShading(own, output)

    def forward(self, *tensors: Tensor) -> Tensor:
        given = {port.name: t for port, t in zip(self.ports, tensors, strict=True)}
        parameters = {
            f"model.{port.parameter}": given.pop(port.name)
            for port in self.ports
            if port.parameter is not None
        }
        return torch.func.functional_call(self.inner, parameters, (given,), strict=False)


class GBufferShading(nn.Module):
    """f_r, or the radiance under one light, of a G-buffer of unit or other vectors."""

    def __init__(self, model: RadenBrdf, output: str) -> None:
        super().__init__()
        self.model = PlanarBrdf(model)
        self.output = output

    def forward(self, given: dict[str, Tensor]) -> Tensor:
        n, l, v = (unit(given[name]) for name in ("normal", "light", "view"))  # noqa: E741
        f, n_l = self.model(n, l, v)
        if self.output == "radiance":
            f = f * n_l * (given["irradiance"] * given["exposure"])
        return _masked(f, given["mask"])


class SceneShading(nn.Module):
    """The radiance of a G-buffer under K lights: `[K, 4]` directions or positions, as in `ports`.

    The lights are a dimension of their own, `[B, K, 3, H, W]`, so that K is free.
    """

    def __init__(self, model: RadenBrdf) -> None:
        super().__init__()
        self.model = PlanarBrdf(model)

    def forward(self, given: dict[str, Tensor]) -> Tensor:
        position = given["position"].unsqueeze(1)
        camera = given["camera"][:, None, :, None, None]
        n, v = unit(given["normal"].unsqueeze(1)), unit(camera - position)
        placed, colour = (given[name][None, :, :, None, None] for name in ("light", "light_colour"))
        near = (placed[:, :, 3:] > 0).float()
        to_light = placed[:, :, :3] - near * position
        x, y, z = xyz(to_light)
        distance_squared = near * (x * x + y * y + z * z) + (1 - near)
        f, n_l = self.model(n, unit(to_light), v)
        image = f * (n_l / distance_squared) * colour
        return _masked(_finite(image).sum(1) * given["exposure"], given["mask"])


def _masked(image: Tensor, mask: Tensor) -> Tensor:
    """Times the mask, 0 where either is not finite."""
    inside = torch.where(torch.isnan(mask), torch.zeros_like(mask), mask).clamp(0, 1)
    return _finite(image) * inside


def _finite(image: Tensor) -> Tensor:
    """0 where it is not finite. Comparing does this in one pass; `IsNaN` and `IsInf` take two."""
    return torch.where(image.abs() < torch.inf, image, torch.zeros(()))


def _with_gains_as_tensors(model: RadenBrdf) -> RadenBrdf:
    """A float32 copy whose gains are buffers, which a traced graph can take as inputs."""
    own = copy.deepcopy(model).float().requires_grad_(False).eval()
    for gain, part in zip(GAINS, (own.diffuse, own.table), strict=True):
        if part is not None:
            value = torch.as_tensor(float(getattr(own, gain)))
            delattr(own, gain)
            own.register_buffer(gain, value)
    return own
