"""A run: features of every image and metrics of every pair, in several processes, kept on disk as they come.

May import `data`, `methods`, `metrics` and `suite`.
"""
