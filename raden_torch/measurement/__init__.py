"""Measured reflection: readings, their grid view, their colour, their own file format. No torch."""

from raden_torch.measurement.readings import BrdfMeasurement, Metadata, ReadingGrid

__all__ = ["BrdfMeasurement", "Metadata", "ReadingGrid"]
