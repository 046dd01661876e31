"""`elf-eval`: a module for each subcommand, with its options and what it does.

May import every other room; none imports this one.
"""
