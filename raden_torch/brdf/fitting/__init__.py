"""From a measurement to a model, and how far it is from other readings."""
