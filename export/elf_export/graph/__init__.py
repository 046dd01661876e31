"""ONNX graphs: read, edited, measured, and rewritten by `passes`.

May import errors only; nothing here knows of gradients or keypoints.
"""
