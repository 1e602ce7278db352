"""A model as the tensor file that the material `measured` of Mitsuba 3 and of pbrt-v4 reads."""
