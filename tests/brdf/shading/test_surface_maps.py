"""Maps of a G-buffer beside normals: the layers' normals, tangents, materials."""

import pytest
import torch

import raden_torch as rt
from raden_torch.errors import InputError


def test_film_layers_turn_the_reflection_and_the_surface_keeps_the_cosine():
    model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
    up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    layers = torch.tensor([0.1, 0.05, 1.0]).view(1, 3, 1, 1)
    lamp = rt.DirectionalLight((1, 0, 2), irradiance=2.0)
    image = rt.shade(model, rt.GBuffer(up, view=(-1, 0, 3), layer_normal=layers), lamp)
    light, view = (torch.tensor(d).view(1, 3, 1, 1) for d in ((1.0, 0.0, 2.0), (-1.0, 0.0, 3.0)))
    torch.testing.assert_close(image, model(layers, light, view) * 2 * 2 / 5**0.5)
    assert not torch.allclose(image, rt.shade(model, rt.GBuffer(up, view=(-1, 0, 3)), lamp))


@pytest.mark.parametrize(
    "material",
    [torch.zeros(1, 2, 3, 3, dtype=torch.long), torch.zeros(1, 2, 3, 4), torch.zeros(3, 3)],
)
def test_materials_that_do_not_fit_are_refused(material):
    normal = torch.ones(1, 3, 3, 3)
    with pytest.raises(InputError, match=r"GBuffer material: expected integers \[1, 1, 3, 3\]"):
        rt.GBuffer(normal, view=(0, 0, 1), material=material)
