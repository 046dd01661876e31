"""`elf-eval`: the command line."""
