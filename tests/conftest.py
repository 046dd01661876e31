"""Collection: the export half's tests need torch and onnx, which the runtime's environment has not."""

from __future__ import annotations

import importlib.util

import numpy as np
import numpy.typing as npt
import pytest

import elf_runtime  # noqa: F401  (before any test imports ONNX Runtime, whose telemetry it switches off)
from helpers import textured

NEEDS_TORCH = ("export",)
HAS_TORCH = all(importlib.util.find_spec(name) for name in ("torch", "onnx"))
collect_ignore = [] if HAS_TORCH else list(NEEDS_TORCH)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if set(NEEDS_TORCH) & set(item.path.parts):
            item.add_marker(pytest.mark.torch)


@pytest.fixture
def image() -> npt.NDArray[np.uint8]:
    return textured(120, 160)
