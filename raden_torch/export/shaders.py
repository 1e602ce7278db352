"""The modules that are traced: the model's own eager code, between named inputs and one output."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn

from raden_torch.brdf.lights import inverse_square
from raden_torch.brdf.model import RadenBrdf
from raden_torch.export.profiles import GAINS, Port
from raden_torch.geometry import dot, normalised


class Shader(nn.Module):
    """A profile over a model: tensors in the order of the ports → `[B, 3, H, W]`.

    The model's parameters arrive as inputs too, so that the exporter folds none of them away.
    """

    def __init__(self, model: RadenBrdf, profile: str, output: str, ports: list[Port]) -> None:
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
        self.model = model
        self.output = output

    def forward(self, given: dict[str, Tensor]) -> Tensor:
        n, l, v = (normalised(given[name]) for name in ("normal", "light", "view"))  # noqa: E741
        f = self.model.of_unit_vectors(n, l, v)
        if self.output == "radiance":
            f = f * (given["irradiance"] * dot(n, l).clamp(min=0)) * given["exposure"]
        return _masked(f, given["mask"])


class SceneShading(nn.Module):
    """The radiance of a G-buffer under K lights: `[K, 4]` directions or positions, as in `ports`.

    The lights are a dimension of their own, `[B, K, 3, H, W]`, so that K is free.
    """

    def __init__(self, model: RadenBrdf) -> None:
        super().__init__()
        self.model = model

    def forward(self, given: dict[str, Tensor]) -> Tensor:
        position = given["position"].unsqueeze(1)
        camera = given["camera"][:, None, :, None, None]
        n = normalised(given["normal"].unsqueeze(1))
        v = normalised(camera - position)
        placed, colour = (given[name][None, :, :, None, None] for name in ("light", "light_colour"))
        near = placed[:, :, 3:] > 0
        to_light = torch.where(near, placed[:, :, :3] - position, placed[:, :, :3])
        fall_off = torch.where(near, inverse_square(to_light), 1.0)
        direction = normalised(to_light)
        facing = colour * fall_off * dot(n, direction).clamp(min=0)
        image = (self.model.of_unit_vectors(n, direction, v) * facing).sum(1)
        return _masked(image * given["exposure"], given["mask"])


def _masked(image: Tensor, mask: Tensor) -> Tensor:
    """Times the mask, 0 where either is not finite."""
    inside = torch.where(torch.isnan(mask), torch.zeros_like(mask), mask).clamp(0, 1)
    return torch.where(torch.isfinite(image), image, torch.zeros_like(image)) * inside


def _with_gains_as_tensors(model: RadenBrdf) -> RadenBrdf:
    """A float32 copy whose gains are buffers, which a traced graph can take as inputs."""
    own = copy.deepcopy(model).float().requires_grad_(False).eval()
    for gain, part in zip(GAINS, (own.diffuse, own.table), strict=True):
        if part is not None:
            value = torch.as_tensor(float(getattr(own, gain)))
            delattr(own, gain)
            own.register_buffer(gain, value)
    return own
