"""Pictures of what was found: saliency, keypoints and matches drawn on images.

May import everything but `checks` and `commands`.
"""
