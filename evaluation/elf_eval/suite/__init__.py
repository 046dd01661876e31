"""What to run: suites in TOML, the searches over settings, and the paper's own figures to stand beside.

May import the protocol and errors.
"""
