"""`--compress`: convolutions of fewer multiply-adds, in closed form, fitted to what they give on photographs.

`low_rank` has the algebra, `ranks` chooses how much of each convolution stays, `convolutions` finds them in a graph and
samples their responses, and `compress` does all of it to the networks of an export.  May import `graph`, `checks`,
calibration and errors.
"""
