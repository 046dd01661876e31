"""Descriptor maps: those of another network in the same file, and fewer channels by a fitted projection.

May import `graph`, `sources`, the saliency graph, calibration and errors.
"""
