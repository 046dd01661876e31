"""What detection gives: features, the trace that led to them, and matches.

May import the settings, `files` and errors.
"""
