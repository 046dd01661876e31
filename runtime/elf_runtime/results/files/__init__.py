"""Features in files of one image each, by their ending.

`npz` and `table` give and take the fields of `Features` by name; they do not know the class.
"""
