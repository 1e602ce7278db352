"""Thousands of shells in one folder, each kept as it came, found by colour and angle.

`Catalogue` is all that one needs of it.
"""

from __future__ import annotations

from raden_torch.packages import require

require("catalogues", "catalogue")

from raden_torch.catalogue.catalogue import Added, Catalogue
from raden_torch.catalogue.colour_query import ColourQuery, Geometry
from raden_torch.catalogue.entry import Entry
from raden_torch.catalogue.search import Found

__all__ = ["Added", "Catalogue", "ColourQuery", "Entry", "Found", "Geometry"]
