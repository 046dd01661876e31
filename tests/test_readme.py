"""README's Python runs as it stands, from a fresh clone after `pip install .`: without what `make demo` writes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


def test_the_first_block_runs_in_a_fresh_clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "demo").symlink_to(ROOT / "demo", target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    (block,) = BLOCKS
    names: dict[str, Any] = {}
    exec(block, names)
    a, b, pairs, points, descriptors = (names[name] for name in ("a", "b", "pairs", "points", "descriptors"))
    assert (len(a), len(b)) == (500, 300)
    assert a.keypoints.shape == (500, 2)
    assert a.descriptors.shape == (500, 128)
    assert pairs.shape[1] == 2
    # The second is a part of the first: what matches lies where it was cut out.
    shifts = a.keypoints[pairs[:, 0]] - b.keypoints[pairs[:, 1]]
    assert len(pairs) > 200
    np.testing.assert_allclose(np.median(shifts, axis=0), (60, 40), atol=0.5)
    assert (len(points), descriptors.shape) == (500, (500, 128))
