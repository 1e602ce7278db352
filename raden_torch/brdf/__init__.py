"""The model: angles to reflectance, and reflectance to an image."""
