"""Files of any kind: told apart by their first bytes, read safely, and written whole or not at all.

Imports no other room.
"""
