"""Many images through one model: decoding, the network and writing overlap, and every image gets files of its own.

May import `engine` and what is below it.
"""
