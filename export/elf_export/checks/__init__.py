"""Is an exported graph right?  Held against torch.autograd, central differences, and its own float32 form.

May import all but `precision` and `command`.
"""
