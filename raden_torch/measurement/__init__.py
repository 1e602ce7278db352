"""Measured reflection: readings, their grid view, their colour, their own file format. No torch."""

from raden_torch.measurement.reading_grid import ReadingGrid
from raden_torch.measurement.readings import BrdfMeasurement, Metadata

__all__ = ["BrdfMeasurement", "Metadata", "ReadingGrid"]
