"""The shader in other programs: ONNX files, checked in the runtimes that will run them."""
