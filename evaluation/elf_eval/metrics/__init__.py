"""The metrics of a pair of images, and the intervals of their means.

A metric is a function of features and ground truth: no files, no images, no methods.  A new one is a `MetricFamily` in
a file of its own and a row of `families.FAMILIES`.  May import `data` (the ground truth).
"""
