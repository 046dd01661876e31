"""ONNX graphs: read (`view`), edited (`graph`), measured (`cost`, `receptive_field`), and rewritten by `passes`.

May import errors, and the runtime to run a model; nothing here knows of gradients or keypoints.
"""
