"""A contact sheet: the mask's part under each lamp, in rows, with a dial that shows the lamp."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from raden_torch.brdf.shading.relight import lamp_ring
from raden_torch.contact_sheet import contact_sheet

H, W = 120, 150
MARGIN = 4  # pixels: 6 % of the object's size, and no fewer


def tiles(count: int) -> Tensor:
    """Lamp k makes everything k + 1 hundredths bright."""
    return torch.arange(1, count + 1).view(-1, 1, 1, 1, 1).expand(-1, 1, 3, H, W) / 100


def square_mask() -> Tensor:
    """Rows 30 to 69 and columns 40 to 99."""
    mask = torch.zeros(1, 1, H, W)
    mask[..., 30:70, 40:100] = 1
    return mask


@pytest.mark.parametrize(("count", "across"), [(1, 1), (4, 2), (6, 3), (12, 4)])
def test_the_masks_part_stands_under_each_lamp_in_rows(count: int, across: int) -> None:
    """Expected: tiles of 48 x 68 pixels, lamp by lamp in reading order; near 3:2 as a whole."""
    sheet = contact_sheet(tiles(count), square_mask(), lamp_ring(count), exposed=False)
    height, width = 40 + 2 * MARGIN, 60 + 2 * MARGIN
    assert sheet.shape == (1, 3, count // across * height, across * width)
    corners = sheet[0, 0, ::height, ::width].flatten()
    torch.testing.assert_close(corners, torch.arange(1, count + 1) / 100)


def test_without_a_gain_the_mask_is_exposed() -> None:
    """Brighter than before, but not the dark around it: the sheet's brightest tile is near 1."""
    plain = contact_sheet(tiles(4), square_mask(), lamp_ring(4), exposed=False)
    exposed = contact_sheet(tiles(4), square_mask(), lamp_ring(4), exposed=True)
    first, last = exposed[0, 0, 0, 0], exposed[0, 0, 48, 68]
    assert last / first == pytest.approx(4.0)
    assert last / plain[0, 0, 48, 68] == first / plain[0, 0, 0, 0]
    assert 0.5 < last <= 1.0


@pytest.mark.parametrize("elevation_deg", [0.0, 60.0])
@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_the_dials_dot_is_where_the_lamp_is(turn: int, elevation_deg: float) -> None:
    """Expected: right, up, left, down of the dial's centre, nearer to it the higher the lamp."""
    lamp = lamp_ring(4, elevation_deg)[turn]
    sheet = contact_sheet(torch.zeros(1, 1, 3, H, W), torch.ones(1, 1, H, W), [lamp], exposed=False)
    radius = 0.05 * H
    centre_x, centre_y = W - 1 - 1.6 * radius, H - 1 - 1.6 * radius
    rows, columns = torch.nonzero(sheet[0, 0] > 0.8, as_tuple=True)
    found_x, found_y = columns.double().mean() - centre_x, centre_y - rows.double().mean()
    out = radius * torch.cos(torch.deg2rad(torch.tensor(elevation_deg))).item()
    expected = [(out, 0.0), (0.0, out), (-out, 0.0), (0.0, -out)][turn]
    assert found_x.item() == pytest.approx(expected[0], abs=0.5)
    assert found_y.item() == pytest.approx(expected[1], abs=0.5)
