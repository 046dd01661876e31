"""What is shown: the page of a run with its tables, plots and pictures; comparisons, sweeps and the front of a study.

A table is text in Markdown; matplotlib draws where it is installed.  May import all other rooms but `command`.
"""
