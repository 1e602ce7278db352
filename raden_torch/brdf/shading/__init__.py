"""From a model to an image: G-buffer, lights, shading, relighting."""
