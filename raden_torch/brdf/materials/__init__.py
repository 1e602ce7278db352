"""What surfaces are made of, where one measured model is not all: parts of the same `shade`."""
