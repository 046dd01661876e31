"""From matches to the geometry of two views: refined places, homographies, epipolar geometry, relative pose.

May import the rooms of images and results below it.
"""
