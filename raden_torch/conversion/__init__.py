"""Measurements and models as files of other programs: what `raden convert` does."""
