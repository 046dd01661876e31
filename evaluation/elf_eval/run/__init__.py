"""A run: features of every image and metrics of every pair, in several processes, kept on disk as they come.

What it finds is a `results.Results`, which `averages` turns into figures.  May import `suite`, `methods`, `metrics` and
`data`.
"""
