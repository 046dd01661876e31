"""What detection gives: features, the trace that led to them, and matches.

May import `pictures`, `image`, the settings, `files` and errors.
"""
