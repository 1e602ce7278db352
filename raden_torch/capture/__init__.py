"""Everything that makes a `BrdfMeasurement`."""
