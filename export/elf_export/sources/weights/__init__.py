"""Trained tensors: where they come from (`load`), in which formats, and the proof that they are the right ones."""
