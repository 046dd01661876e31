"""What detection gives: features, the trace that led to them, matches, and the geometry that matches agree with.

May import the settings, `files` and errors.
"""
