"""ELF models from anyone's .onnx file: read, find the image, name the layer, free the sizes.  No torch."""
