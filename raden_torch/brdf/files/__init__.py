"""Models, G-buffers, photographs and pictures as files."""
