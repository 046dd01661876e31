"""A web page that shows keypoints and lets settings be tried: one file, which needs no server and no network.

May import `engine` and what is below it.
"""
