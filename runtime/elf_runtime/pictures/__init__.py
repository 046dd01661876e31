"""Pictures of what was found: saliency, keypoints and matches drawn on images.

May import `image` and all below it.  Results draw themselves in notebooks, so they import this room: it knows them by
their attributes only.
"""
