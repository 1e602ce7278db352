"""A reflectance over three angles: its grid, its symmetries, and what lies between readings.

Arrays alone, without torch: angles `[M, 3]` are incidence, receiving and tilt in degrees, values
reflectance factors (the perfect diffuser = 100), three channels XYZ.
"""
