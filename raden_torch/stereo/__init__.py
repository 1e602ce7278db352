"""Photometric stereo by a model of the material: normals of what is not matt, and inlays."""

from raden_torch.packages import require

require("photographs", "photo")
