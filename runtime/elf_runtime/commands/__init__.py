"""The runtime's commands, a file each: detect, match, info and bench; the other files are what they share.

May import every other room.  elf_export and elf_eval import `command` (parser, exit status, errors), the types of
options in `options`.
"""
