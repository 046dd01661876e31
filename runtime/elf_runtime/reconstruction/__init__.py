"""Sparse models of scenes: features and verified matches in COLMAP's database, the model, and places in it.

Needs pycolmap, the extra ``sfm``, which is imported when it is used first.  May import the engine, and all below it.
"""

from __future__ import annotations

from .cameras import Calibration, Camera, shared_cameras
from .database import write_database
from .localize import Localization, localize
from .mapping import map_database
from .model import Model, read_model
from .pairs import exhaustive, sequential

__all__ = [
    "Calibration",
    "Camera",
    "Localization",
    "Model",
    "exhaustive",
    "localize",
    "map_database",
    "read_model",
    "sequential",
    "shared_cameras",
    "write_database",
]
