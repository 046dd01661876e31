"""A small network in floats and in 8 bits, and pictures to fit ranges to."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest

from elf_export.graph.graph import GraphView
from elf_export.precision.int8.rewrite import rewrite
from helpers import textured

from .rounded_networks import NETWORKS, images, saliency, schemes_of


@pytest.fixture(params=NETWORKS)
def network(request: pytest.FixtureRequest) -> tuple[onnx.ModelProto, onnx.ModelProto, np.ndarray]:
    """A float saliency graph, its 8-bit form, and images."""
    model, x = saliency(NETWORKS[request.param]), images()
    lowered, _ = rewrite(GraphView(model), schemes_of(model, x))
    onnx.checker.check_model(lowered, full_check=True)
    return model, lowered, x


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    for seed in range(2):
        cv2.imwrite(str(folder / f"{seed}.png"), textured(150, 200, seed))
    return folder
