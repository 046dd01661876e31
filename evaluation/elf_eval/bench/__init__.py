"""What a method costs: its time, measured alone and interleaved with others', beside its figures.

May import all but `command`.
"""
