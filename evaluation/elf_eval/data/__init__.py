"""Datasets by their folder layout; nothing is downloaded."""

from __future__ import annotations

from .base import Dataset, Pair
from .registry import DATASETS, open_dataset

__all__ = ["DATASETS", "Dataset", "Pair", "open_dataset"]
