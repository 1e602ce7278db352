"""A scene from a file to a picture or an animation: things, light, a camera, time."""
