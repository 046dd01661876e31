"""Labels that cover nothing."""

from __future__ import annotations

import numpy as np

from elf_eval.report.labels import choose


def test_labels_cover_neither_one_another_nor_what_is_taken():
    rng = np.random.default_rng(1)
    at = rng.uniform(100, 700, (12, 2))
    halves = np.tile([[45.0, 12.0]], (12, 1))
    sides = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)], float)
    offsets = np.stack([np.concatenate([sides * (halves[0] + gap) for gap in (8.0, 20.0, 40.0)])] * 12)
    taken = np.concatenate([at - 7, at + 7], axis=1)
    inside = np.array([0.0, 0.0, 800.0, 800.0])
    centres = at + choose(at, halves, offsets, taken, inside)
    assert (centres - halves >= inside[:2]).all()
    assert (centres + halves <= inside[2:]).all()
    gaps = np.abs(centres[:, None] - centres[None])
    apart = (gaps >= 2 * halves[0]).any(axis=2)
    assert apart[~np.eye(12, dtype=bool)].all()
    assert (np.abs(centres[:, None] - at[None]) >= halves[0] + 7).any(axis=2).all()
