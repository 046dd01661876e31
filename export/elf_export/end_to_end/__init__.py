"""What follows the network, inside the graph: an image in, keypoints, scores and descriptors out, in any ONNX runtime.

A file for each step of the runtime's, in their order: resize, levels, places, suppress, refine, describe.  keypoints
puts them together for an image, build for the model.  The runtime's numpy is their specification.  May import the
graph, the contract and errors.
"""
