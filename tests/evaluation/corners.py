"""A plugin, as a user would write one."""

from __future__ import annotations

from elf_eval import LocalFeatures
from elf_eval.methods import Method


class Corners(Method):
    """A plugin: the image's corners, as many as asked."""

    def __init__(self, spec, threads):
        del threads
        self.inset = spec.take("inset", int, 0)
        self.fingerprint = f"corners {self.inset}"

    def extract(self, image, limit):
        (w, h), i = image.size, self.inset
        return LocalFeatures.build([[i, i], [w - 1 - i, i], [i, h - 1 - i]], [3, 2, 1]).first(limit)
