"""XFeat's decoding."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import check

from elf_eval.data.images import ImageRef
from elf_eval.methods import open_method
from elf_eval.methods.xfeat import keypoint_probability, local_maxima, sample_cells


def test_xfeat_puts_a_cells_channels_in_raster_order():
    logits = np.full((65, 2, 3), -20.0, np.float32)
    logits[8 * 5 + 2, 1, 2] = 20.0  # row 5, column 2 of the cell in row 1, column 2
    logits[64, 0, 0] = 20.0  # no keypoint here
    heat = keypoint_probability(logits)
    assert heat.shape == (16, 24)
    assert np.unravel_index(heat.argmax(), heat.shape) == (8 + 5, 16 + 2)
    assert heat.max() == pytest.approx(1.0)
    assert heat[:8, :8].max() < 1e-6
    assert local_maxima(heat, 2)[13, 18]


@pytest.mark.parametrize("cubic", [False, True])
def test_xfeat_samples_a_plane_exactly_between_cell_centres(cubic):
    y, x = np.mgrid[0:8, 0:9].astype(np.float32)
    maps = np.stack([2 * x + 3 * y, x - y])
    points = np.array([[27.5, 35.5], [30.0, 41.3]])
    cells = (points + 0.5) / 8 - 0.5
    expected = np.stack([2 * cells[:, 0] + 3 * cells[:, 1], cells[:, 0] - cells[:, 1]], axis=1)
    # Keys' kernel with a = -0.75 gives back planes at cell centres alone, and nearly so elsewhere.
    assert sample_cells(maps, points, cubic) == pytest.approx(expected, abs=0.2 if cubic else 1e-4)
    centres = np.array([[27.5, 35.5]])
    assert sample_cells(maps, centres, cubic) == pytest.approx(expected[:1], abs=1e-5)


def test_xfeat_on_a_photograph(shared):
    weights = shared / "peers" / "xfeat.onnx"
    if not weights.is_file():
        pytest.skip("no shared/peers/xfeat.onnx")
    pixels = ImageRef("1", shared / "data/oxford_affine/v_graf/1.png").open((640, 480))
    method = open_method(f"xfeat:{weights}", threads=1)
    found = method.extract(pixels, 200)
    check(found, (640, 480))
    assert len(found) == 200
    again = method.describe(pixels, found)
    assert np.linalg.norm(again.descriptors, axis=1) == pytest.approx(1.0, abs=1e-5)
    assert (again.descriptors * found.descriptors).sum(axis=1).min() > 0.9999
