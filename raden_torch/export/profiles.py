"""What goes into an exported shader and what comes out: names, shapes, units, defaults."""

from __future__ import annotations

import re
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.errors import InputError
from raden_torch.export.forms import Form, PaletteForm

PROFILES = ("gbuffer", "scene")
OUTPUTS = ("radiance", "brdf")

_NORMAL = (
    "surface normal; of any length; zero or not finite marks an invalid pixel, which becomes 0"
)
_MASK = "how much of the pixel is this material, 0 to 1; NaN counts as 0"
_EXPOSURE = "linear factor on the output, 2 ** stops"
_PARAMETERS = {
    "table": ("table", "f_r in 1/sr at the nodes of u, v and w; see the text table_address"),
    "table.values": ("table", "total f_r in 1/sr at the nodes of incidence, receiving and tilt"),
    "diffuse.scale": ("diffuse_scale", "S of the diffuse part, per channel, in 1/sr"),
    "diffuse.exponent": ("diffuse_exponent", "n of the diffuse part, per channel, > 0"),
    "diffuse_gain": ("diffuse_gain", "I_d, factor on the diffuse part"),
    "specular_gain": ("specular_gain", "I_s, factor on what the table holds beyond it"),
}


@dataclass(frozen=True)
class GraphInput:
    """One input of the graph.

    Attributes:
        name: as the application calls it.
        shape: a number, or a name for a size that is free; sizes whose names end in the port's own
            name may also be 1.
        doc: what it is, with its unit.
        default: its value where the application gives none; None makes it required.
        parameter: the tensor of the model that it replaces, by its name there.
    """

    name: str
    shape: tuple[int | str, ...]
    doc: str
    default: Tensor | None = None
    parameter: str | None = None

    @property
    def example(self) -> Tensor:
        """A small tensor of this shape to trace with; a size that may be 1 is 1."""
        if self.default is not None:
            return self.default.clone()
        sizes = {"batch": 2, "height": 5, "width": 7, "lights": 3}
        shape = [n if isinstance(n, int) else sizes.get(n, 1) for n in self.shape]
        return torch.rand(shape, generator=torch.Generator().manual_seed(0))


def check_profile(profile: str, output: str) -> None:
    """Raise InputError unless there is such a profile with such an output."""
    if profile not in PROFILES:
        raise InputError(f"profile: expected one of {', '.join(PROFILES)}, got {profile!r}")
    if output not in OUTPUTS:
        raise InputError(f"output: expected one of {', '.join(OUTPUTS)}, got {output!r}")
    if (profile, output) == ("scene", "brdf"):
        raise InputError(
            "output: expected radiance from the scene profile, got 'brdf'; use the gbuffer profile"
        )


def ports(form: Form, profile: str, output: str) -> list[GraphInput]:
    """The inputs in their order: required ones first, then those with a default."""
    check_profile(profile, output)
    if profile == "scene":
        if isinstance(form, PaletteForm) and form.by == "weights":
            raise InputError(
                "material: expected index with the scene profile, got 'weights'; use the gbuffer "
                "profile"
            )
        required = [*_scene_ports(), *_material_port(form)]
        return [*required, _mask_port(), _exposure_port(), *_parameter_ports(form)]
    light = [*_gbuffer_ports(), *_material_port(form), _mask_port()]
    if output == "radiance":
        light += [_irradiance_port(), _exposure_port()]
    return light + _parameter_ports(form)


def output_doc(output: str) -> str:
    """What the graph's one output is."""
    if output == "brdf":
        return "f_r in 1/sr, without the cosine; linear RGB, sRGB primaries, unclipped, finite"
    return "outgoing radiance; scene-linear RGB, sRGB primaries, unclipped, finite"


def port_name(parameter: str) -> str:
    """The name of the input that replaces a parameter or buffer of the model."""
    member = re.fullmatch(r"members\.(\d+)\.table", parameter)
    if member is not None:
        return f"table_{member[1]}"
    return _PARAMETERS.get(parameter, (parameter.replace(".", "_"), ""))[0]


def _map(name: str, doc: str, channels: int = 3, default: Tensor | None = None) -> GraphInput:
    """A map that may be given once for all images, or once for all pixels."""
    shape = (f"batch_of_{name}", channels, f"height_of_{name}", f"width_of_{name}")
    return GraphInput(name, shape, f"{doc}; a size may be 1, which then holds for all", default)


def _gbuffer_ports() -> list[GraphInput]:
    return [
        GraphInput("normal", ("batch", 3, "height", "width"), _NORMAL),
        _map("light", "direction from the surface to the light; of any length"),
        _map("view", "direction from the surface to the viewer; of any length"),
    ]


def _scene_ports() -> list[GraphInput]:
    size = ("batch", 3, "height", "width")
    light = (
        "x, y, z, w of each light; w = 0: (x, y, z) is the direction to a light at infinity; "
        "w = 1: the position of a point light"
    )
    colour = (
        "linear RGB of each light; w = 0: irradiance on a plane that faces the light (pi lights a "
        "perfect white diffuser to radiance 1); w = 1: intensity, divided by the distance squared"
    )
    return [
        GraphInput("normal", size, _NORMAL),
        GraphInput("position", size, "surface point, in the frame of the normals"),
        GraphInput(
            "camera", ("batch_of_camera", 3), "position of the viewer; the first size may be 1"
        ),
        GraphInput("light", ("lights", 4), light),
        GraphInput("light_colour", ("lights", 3), colour),
    ]


def _material_port(form: Form) -> list[GraphInput]:
    """What chooses of a palette; nothing to choose elsewhere."""
    if not isinstance(form, PaletteForm):
        return []
    count = len(form.members)
    if form.by == "weights":
        doc = f"how much of each of {count} materials a pixel shows; they should sum to 1"
        return [GraphInput("weights", ("batch", count, "height", "width"), doc)]
    doc = f"which material a pixel shows, 0 to {count - 1}, rounded; it becomes 0 for any other"
    return [GraphInput("material", ("batch", 1, "height", "width"), doc)]


def _mask_port() -> GraphInput:
    return _map("mask", _MASK, 1, torch.ones(1, 1, 1, 1))


def _irradiance_port() -> GraphInput:
    doc = (
        "linear RGB irradiance on a plane that faces the light; pi lights a perfect white diffuser "
        "to radiance 1"
    )
    return _map("irradiance", doc, 3, torch.full((1, 3, 1, 1), torch.pi))


def _exposure_port() -> GraphInput:
    return GraphInput("exposure", (), _EXPOSURE, torch.ones(()))


def _parameter_ports(form: Form) -> list[GraphInput]:
    """Every tensor of the form, so that one file serves many shells."""
    found = []
    for name, tensor in form.state_dict().items():
        known = _PARAMETERS.get("table" if name.endswith(".table") else name)
        doc = f"{name} of the model" if known is None else known[1]
        shape = tuple(tensor.shape)
        found.append(GraphInput(port_name(name), shape, doc, tensor.detach().float(), name))
    return found
