"""A camera as an instrument: photographs → linear radiance, colour, the camera and its pose.

Arrays here are NumPy and as OpenCV has them, `[H, W, 3]` RGB with x to the right and y down; what
goes on to the model is turned into the project's maps at the end (docs/conventions.md).
"""

from raden_torch.packages import require

require("photographs", "photo")
