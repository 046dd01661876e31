"""Files of any kind: told apart by their first bytes, read safely, and written whole or not at all.

May import the errors only.
"""
