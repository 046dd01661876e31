"""A verified float32 model in fewer bits: float16, bfloat16 weights, 8-bit integers.

May import `graph`, `adjoint`, `checks`, calibration and errors.
"""
