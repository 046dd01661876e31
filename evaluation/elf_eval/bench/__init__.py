"""What a matching score costs: the time of every method of a suite, beside its figures of a run.

Each method runs in a process of its own, and all take turns.  `elf-bench`, which times one model, is the runtime's.
May import `run` and what that may import.
"""
