"""Inputs that a correct export must get right: ordinary ones, and every edge of the conventions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import torch
from torch import Tensor

from raden_torch.export.forms import Form, PaletteForm
from raden_torch.export.profiles import GraphInput, ports

_SEED = 2012


@dataclass(frozen=True)
class StressCase:
    """One call of the shader: a name for people, and the inputs by name."""

    name: str
    inputs: dict[str, Tensor]

    @property
    def is_basic(self) -> bool:
        """Whether it has pixels and lights, and leaves all optional inputs at their defaults."""
        required = {"normal", "light", "view", "position", "camera", "light_colour"}
        required |= {"material", "weights"}
        return set(self.inputs) <= required and all(t.numel() for t in self.inputs.values())


def cases(form: Form, profile: str, output: str, *, fixed: bool = False) -> list[StressCase]:
    """The stress set of a profile; the same numbers every time.

    Args:
        fixed: the form's parameters are constants in the file, and no inputs.
    """
    draw = torch.Generator().manual_seed(_SEED)
    if profile == "scene":
        found = _scene_cases(draw)
        ordinary = _scene((2, 6, 5), 3, draw)
    else:
        found = _gbuffer_cases(draw)
        ordinary = _vectors((2, 6, 5), draw)
    changed = {
        p.name: _changed(p)
        for p in ports(form, profile, output)
        if p.default is not None and not (fixed and p.parameter)
    }
    masked = _mask((2, 6, 5), draw)
    made = [
        *found,
        StressCase("mask", ordinary | {"mask": masked}),
        StressCase(
            "other lamp" if fixed else "other shell",
            ordinary | changed | {"mask": masked[:, :, :1]},
        ),
    ]
    if isinstance(form, PaletteForm):
        made = [replace(case, inputs=case.inputs | _material(form, case, draw)) for case in made]
    return made


def _material(form: PaletteForm, case: StressCase, draw: torch.Generator) -> dict[str, Tensor]:
    """Indices, among the odd vectors with some that are none; or weights, of which some are 0."""
    batch, _, height, width = case.inputs["normal"].shape
    count = len(form.members)
    if form.by == "weights":
        drawn = torch.relu(torch.randn(batch, count, height, width, generator=draw))
        return {"weights": (drawn + 1e-6) / (drawn + 1e-6).sum(1, keepdim=True)}
    index = torch.randint(0, count, (batch, 1, height, width), generator=draw).float()
    if case.name == "not vectors":
        odd = torch.tensor([-1.0, count, 1e30, float("nan"), float("inf"), 0.25])
        pick = torch.randint(0, 60, index.shape, generator=draw)
        index = torch.where(pick < len(odd), odd[pick.clamp(max=len(odd) - 1)], index)
    return {"material": index}


def _gbuffer_cases(draw: torch.Generator) -> list[StressCase]:
    normal, light, view = _vectors((2, 64, 48), draw).values()
    n, l, v = (_unit(vectors) for vectors in (normal, light, view))  # noqa: E741
    near = _unit(l + 10 ** (-5 + 4 * _uniform((2, 1, 64, 48), draw)) * v)
    mix = _uniform((2, 1, 64, 48), draw)
    grazing = torch.linalg.cross(l, v, dim=1) + (mix - 0.5) * 0.02 * (l + v)
    triples = {
        "random": (n, l, v),
        "of any length": (normal, light, view),
        "L near V": (n, l, near),
        "L near V, of any length": (normal, light, near * _uniform((2, 1, 64, 48), draw)),
        "L almost opposite V": (n, l, -near),
        "L parallel to V": (n, l, l),
        "grazing": (_unit(grazing), l, v),
        "N in the plane of L and V": (_unit(mix * l + (1 - mix) * v), l, v),
        "axes": _axes(),
        "not vectors": _not_vectors(draw),
        "one light for all pixels": (n, l[:1, :, :1, :1], v[:, :, :1, :1]),
        **{str(size): tuple(_vectors(size, draw).values()) for size in _SIZES},
    }
    return [
        StressCase(name, dict(zip(("normal", "light", "view"), maps, strict=True)))
        for name, maps in triples.items()
    ]


_SIZES = ((1, 1, 1), (1, 3, 7), (3, 7, 3), (1, 0, 4), (1, 4, 0))
"""Batch, height, width."""


def _scene_cases(draw: torch.Generator) -> list[StressCase]:
    ring = _scene((1, 24, 32), 4, draw)
    ring["light"] = ring["camera"] + 0.02 * torch.randn(4, 3, generator=draw)
    ring["light"] = torch.cat([ring["light"], torch.ones(4, 1)], 1)
    at_camera = _scene((1, 24, 32), 1, draw)
    at_camera["light"] = torch.cat([at_camera["camera"], torch.ones(1, 1)], 1)
    broken = _scene((1, 24, 32), 3, draw)
    for name in ("normal", "position"):
        broken[name] = _sprinkled(broken[name], draw)
    each = _scene((2, 24, 16), 5, draw)
    each["camera"] = torch.tensor([[0.0, 0.0, 5.0], [1.0, 2.0, 4.0]])
    return [
        StressCase("random", each),
        StressCase("lamps around the camera", ring),
        StressCase("lamp at the camera", at_camera),
        StressCase("not vectors", broken),
        *(StressCase(f"{k} lights", _scene((1, 5, 6), k, draw)) for k in (0, 1, 7)),
        *(StressCase(str(size), _scene(size, 2, draw)) for size in _SIZES),
    ]


def _scene(size: tuple[int, int, int], lights: int, draw: torch.Generator) -> dict[str, Tensor]:
    """A bumpy unit sphere below a camera, under lights of both kinds."""
    batch, height, width = size
    position = torch.randn(batch, 3, height, width, generator=draw)
    position = torch.nn.functional.normalize(position, dim=1)
    position[:, 2] = position[:, 2].abs()
    light = torch.randn(lights, 4, generator=draw) * 3
    light[:, 2] = light[:, 2].abs() + 1.5
    light[:, 3] = torch.arange(lights) % 2
    return {
        "normal": 2 * position + 0.5 * torch.randn(position.shape, generator=draw),
        "position": position,
        "camera": torch.tensor([[0.3, -0.2, 5.0]]),
        "light": light,
        "light_colour": _uniform((lights, 3), draw) * (1 + 9 * light[:, 3:]),
    }


def _vectors(size: tuple[int, int, int], draw: torch.Generator) -> dict[str, Tensor]:
    """Normals of any length with light and viewer mostly above the horizon."""
    batch, height, width = size
    shape = (batch, 3, height, width)
    normal = torch.randn(shape, generator=draw)
    unit = torch.nn.functional.normalize(normal, dim=1)
    light = torch.randn(shape, generator=draw) + 1.5 * unit
    view = torch.randn(shape, generator=draw) + 1.5 * unit
    return {"normal": normal, "light": light, "view": view}


def _unit(vectors: Tensor) -> Tensor:
    """Unit to the last bit of float32, as a careful renderer has them."""
    return torch.nn.functional.normalize(vectors.double(), dim=1).float()


def _axes() -> tuple[Tensor, Tensor, Tensor]:
    """Every triple of axes and diagonals: right angles, equal, opposite and zero vectors."""
    corners = torch.tensor(list(product((-1.0, 0.0, 1.0), repeat=3)))
    index = torch.cartesian_prod(*3 * [torch.arange(27)])
    normal, light, view = (corners[i].T.reshape(1, 3, 81, 243) for i in index.T)
    return normal, light, view


def _not_vectors(draw: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
    normal, light, view = (_sprinkled(v, draw) for v in _vectors((1, 32, 32), draw).values())
    return normal, light, view


def _sprinkled(vectors: Tensor, draw: torch.Generator) -> Tensor:
    """A tenth of the vectors made zero, not finite, huge or tiny."""
    odd = torch.tensor([0.0, float("nan"), float("inf"), -float("inf"), 1e30, 1e-30])
    vectors = vectors.clone()
    pick = torch.randint(0, 60, vectors[:, :1].shape, generator=draw)
    whole = pick.expand_as(vectors).clone()
    whole[:, 1:][pick.expand_as(vectors[:, 1:]) % 2 == 1] = 59  # one component only
    for i, value in enumerate(odd):
        vectors[whole == i] = value
    return vectors


def _mask(size: tuple[int, int, int], draw: torch.Generator) -> Tensor:
    batch, height, width = size
    values = torch.tensor([0.0, 0.5, 1.0, float("nan"), -1.0, 2.0])
    return values[torch.randint(0, 6, (batch, 1, height, width), generator=draw)]


def _changed(port: GraphInput) -> Tensor:
    """Another shell, or another exposure, of the same shape."""
    assert port.default is not None
    ramp = torch.linspace(0.7, 1.1, port.default.numel()).reshape(port.default.shape)
    return port.default * ramp


def _uniform(shape: tuple[int, ...], draw: torch.Generator) -> Tensor:
    return torch.rand(shape, generator=draw)
