"""The one error that the evaluation raises on purpose."""

from __future__ import annotations


class EvalError(Exception):
    """What was wrong (file, pair, option), what was expected, and what to do next."""
