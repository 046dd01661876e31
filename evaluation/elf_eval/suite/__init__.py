"""What to run: suites in TOML, the grid of a sweep, and the paper's own figures to stand beside ours.

May import the modules beside the rooms alone.
"""
