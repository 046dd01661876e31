"""`elf-export`: the command line, and the tables that it prints."""
