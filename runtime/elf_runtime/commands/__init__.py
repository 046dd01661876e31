"""The runtime's commands, a file each: detect, match, info, bench.  What they share is in the others.

May import every other room.  elf_export and elf_eval take their parsers and their exit status from `command`.
"""
