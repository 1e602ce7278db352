"""Photographs → BRDF: every lit pixel of a sample of known shape is a reading.

Points, normals and directions are `[P, 3]` in the frame of the lights files: x right, y up, z to
the viewer; in mm with a camera (which is at 0), in pixels where the camera is far away.
"""
