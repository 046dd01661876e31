"""Pictures of what was found: saliency, keypoints and matches drawn on images.

May import the results and all below them.
"""
