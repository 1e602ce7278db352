"""What an exported table's description says of the whole reflection, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from raden_torch import geometry
from raden_torch.brdf.materials.microfacet import ggx
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.export.forms import RuntimeForm
from raden_torch.export.whole_reflection import ALBEDO_NODES, highlight_roughness, view_albedo


def test_a_lambertian_surface_returns_its_reflectance() -> None:
    table = torch.full((5, 5, 5, 3), 0.4 / torch.pi) * torch.tensor([1.0, 0.5, 0.0])
    albedo = view_albedo(RuntimeForm(table, RuntimeLayout((5, 5, 5), (0.4, 0.4))))
    assert len(albedo) == ALBEDO_NODES
    np.testing.assert_allclose(albedo, np.tile([0.4, 0.2, 0.0], (ALBEDO_NODES, 1)), rtol=1e-5)


class Facets(RuntimeForm):
    """A GGX density of slopes over an even body."""

    def __init__(self, alpha: float) -> None:
        super().__init__(torch.zeros(3, 3, 3, 3), RuntimeLayout((3, 3, 3), (1.0, 1.0)))
        self.alpha = alpha

    def of_unit_vectors(self, n, l, v):  # noqa: E741
        h = geometry.normalised(l + v)
        return (0.3 + ggx(geometry.dot(n, h), self.alpha)).expand(-1, 3, -1, -1)


@pytest.mark.parametrize("alpha", [0.05, 0.15, 0.3])
def test_the_roughness_of_a_ggx_lobe_is_its_alpha(alpha: float) -> None:
    assert highlight_roughness(Facets(alpha)) == pytest.approx(alpha, rel=0.06)
