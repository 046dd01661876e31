"""A sweep's table, as plain text, and the same as plain data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from elf_eval.metrics.families import is_share
from elf_eval.metrics.intervals import Difference, Estimate
from elf_eval.run.sweep import Trial


def sweep_table(found: Sequence[Trial], metric: str) -> str:
    """A line for each trial, with shares in percent."""
    lines = [f"{metric:>7} chosen  held out [95 %]        gain [95 %]             keypoints  method"]
    by = 100.0 if is_share(metric) else 1.0
    for t in found:
        held = f"{by * t.held_out.mean:5.1f} {_interval(by, t.held_out, '.0f')}"
        gain = f"{by * t.gain.mean:+5.1f} {_interval(by, t.gain, '+.1f')}"
        count = f"{t.count.mean:.0f} ({t.count.least})"
        lines.append(f"{by * t.tuned.mean:14.1f}  {held:22}  {gain:22}  {count:9}  {t.text}")
    return "\n".join(lines)


def sweep_json(found: Sequence[Trial]) -> list[dict[str, Any]]:
    """The trials in the table's order, shares in [0, 1]; a single scene's interval is null."""
    return [{key: _plain(value) for key, value in asdict(trial).items()} for trial in found]


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value


def _interval(by: float, of: Estimate | Difference, digits: str) -> str:
    """In brackets; nothing for a single scene, which has no interval."""
    return "" if math.isnan(of.low) else f"[{by * of.low:{digits}}, {by * of.high:{digits}}]"
