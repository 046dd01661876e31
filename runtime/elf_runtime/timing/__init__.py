"""Timings that can be compared: interleaved repetitions, fresh processes, statistics, and the machine they ran on.

For elf-bench and elf-eval's pareto.  May import the package's version and errors only.
"""
