"""What detection gives: features, their matches, and the two-view geometry that matches agree with.

May import the settings, `files` and errors.
"""
