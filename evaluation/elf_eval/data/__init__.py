"""Datasets by the layout of their folders: pairs of images, and what is known between them.

A new one is a function ``Spec -> Dataset`` in a file of its own and a row of `kinds.DATASETS`.  Nothing is downloaded.
May import the modules beside the rooms alone.
"""

from __future__ import annotations

from .dataset import Dataset, Pair, is_of
from .kinds import DATASETS, open_dataset

__all__ = ["DATASETS", "Dataset", "Pair", "is_of", "open_dataset"]
