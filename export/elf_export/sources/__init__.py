"""Where a network comes from: a name and trained weights (`networks`, `weights`), or anybody's ONNX file (`foreign`).

May import `graph`, `adjoint`, preprocessing and errors.
"""
