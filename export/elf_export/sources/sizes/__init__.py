"""The image sizes that a graph takes, found by running it: the forward graph's, and then the finished one's.

May import `graph`, `saliency` and errors.
"""
