"""Photometric stereo by a model of the material: normals of what is not matt, and inlays."""
