"""Descriptor maps: those of another network in the same file, and fewer channels by a fitted projection.

May import `graph`, `checks`, the saliency graph, calibration and errors.
"""
