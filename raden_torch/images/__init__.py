"""Image files as arrays: what photographs, normal maps and G-buffers are read and written with."""
