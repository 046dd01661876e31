"""Average-pooling in place of maxima, and an image that the network sees smaller."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
import torch
import torch.nn.functional as F
from onnx import helper

from elf_export import LayerError
from elf_export.graph.graph import Graph
from elf_export.graph.passes import average_pools, convolve_averages, shrink_image
from elf_runtime.model.session import open_session
from export.small_models import model, written


def run(net: onnx.ModelProto, x: np.ndarray) -> np.ndarray:
    return np.asarray(open_session(net.SerializeToString())[0].run(None, {"x": x.astype(np.float32)})[0])


def pool(**attributes: object) -> onnx.ModelProto:
    return model([helper.make_node("MaxPool", ["x"], ["y"], name="pool", **attributes)], {}, (1, 2, "H", "W"), "y")


@pytest.mark.parametrize(
    ("kernel", "stride", "padding", "ceil"), [(2, 2, 0, False), (3, 2, 1, False), (3, 2, 0, True), (3, 1, 1, False)]
)
def test_maxima_become_means(kernel: int, stride: int, padding: int, ceil: bool) -> None:
    net = pool(kernel_shape=[kernel] * 2, strides=[stride] * 2, pads=[padding] * 4, ceil_mode=int(ceil))
    x = np.random.default_rng(0).standard_normal((1, 2, 11, 14))
    found = run(average_pools(Graph(net)).model, x)
    wanted = F.avg_pool2d(torch.tensor(x), kernel, stride, padding, ceil, count_include_pad=False).numpy()
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    assert found.shape == run(net, x).shape


def test_pools_without_a_mean_of_their_own_are_refused() -> None:
    with pytest.raises(LayerError, match="no max-pooling"):
        average_pools(Graph(written("y = Relu(x)", {}, (1, 2, "H", "W"))))
    with pytest.raises(LayerError, match="'pool' has dilated windows"):
        average_pools(Graph(pool(kernel_shape=[2, 2], dilations=[2, 2])))


def reads_twice(layout: str) -> onnx.ModelProto:
    shape = [1 if axis == "N" else 2 if axis == "C" else axis for axis in layout]
    return written("a = Relu(x)  b = Neg(x)  c = Relu(b)  y = Sub(a, c)", {}, shape)  # y = x


@pytest.mark.parametrize("layout", ["NCHW", "NHWC"])
@pytest.mark.parametrize("ratio", [0.5, 0.75, 0.36, 0.25, 1.5, 2.0])
def test_pixels_of_the_smaller_image_lie_where_they_should(ratio: float, layout: str) -> None:
    """A ramp that is resized is the ramp at the new pixels' centres, but for the border, where it ends."""
    height, width = 47, 60
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    x = np.stack([columns, rows])[None]
    axes = ["NCHW".index(axis) for axis in layout]
    found = run(shrink_image(Graph(reads_twice(layout)), "x", layout, ratio).model, x.transpose(axes))
    found = found.transpose([layout.index(axis) for axis in "NCHW"])
    k = max(1, int(1 / ratio))
    assert found.shape == (1, 2, int(height // k * (ratio * k)), int(width // k * (ratio * k)))
    inside = slice(2, -2)
    for channel, axis in ((0, 3), (1, 2)):
        places = (np.arange(found.shape[axis]) + 0.5) / ratio - 0.5
        wanted = np.broadcast_to(places if axis == 3 else places[:, None], found.shape[2:])
        np.testing.assert_allclose(found[0, channel][inside, inside], wanted[inside, inside], atol=1e-4)


def test_half_the_size_is_the_mean_of_four() -> None:
    x = np.random.default_rng(1).standard_normal((1, 2, 9, 12))
    found = run(shrink_image(Graph(reads_twice("NCHW")), "x", "NCHW", 0.5).model, x)
    wanted = x[:, :, :8].reshape(1, 2, 4, 2, 6, 2).mean(axis=(3, 5))
    np.testing.assert_allclose(found, wanted, atol=1e-6)


@pytest.mark.parametrize("padded", [False, True])
def test_averages_as_convolutions(padded: bool) -> None:
    given = {"kernel_shape": [2, 3], "strides": [2, 2], "pads": [1, 1, 1, 1] if padded else [0] * 4}
    net = model([helper.make_node("AveragePool", ["x"], ["y"], name="pool", **given)], {}, (1, 2, "H", "W"), "y")
    changed = convolve_averages(Graph(net)).model
    assert [node.op_type for node in changed.graph.node] == ["AveragePool" if padded else "Conv"]
    x = np.random.default_rng(2).standard_normal((1, 2, 9, 12))
    np.testing.assert_allclose(run(changed, x), run(net, x), atol=1e-6)
