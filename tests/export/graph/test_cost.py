"""Multiply-adds, against counts by hand."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from onnx import helper

from elf_export import Preprocessing, build_saliency
from elf_export.contract import macs_per_pixel
from elf_export.errors import ExportError
from elf_export.graph.cost import macs, sizes_of
from elf_export.graph.graph import Graph
from export import small_models as small


def of_unknown_size(nodes: small.Nodes, tensors: dict[str, np.ndarray], output: str) -> onnx.ModelProto:
    """`nodes` behind x (1, 3, 16, 16), as `hidden` (1, 3, 64, 4): the target of its Reshape is computed."""
    front = [
        helper.make_node("Neg", ["negative"], ["computed"]),
        helper.make_node("Reshape", ["x", "computed"], ["hidden"]),
    ]
    tensors = {"negative": np.array([-1, -3, 1, -4], np.int64)} | tensors
    return small.model(front + nodes, tensors, (1, 3, 16, 16), output)


@pytest.mark.parametrize(
    ("node", "kernel", "count"),
    [
        (helper.make_node("MatMul", ["hidden", "w"], ["y"]), (4, 7), 3 * 64 * 4 * 7),
        (helper.make_node("Conv", ["hidden", "w"], ["y"], pads=[1] * 4), (5, 3, 3, 3), 64 * 4 * 5 * 27),
        (
            helper.make_node("ConvTranspose", ["hidden", "w"], ["y"], strides=[2, 2]),
            (3, 5, 2, 2),
            64 * 4 * 3 * 20,
        ),
    ],
    ids=["MatMul", "Conv", "ConvTranspose"],
)
def test_what_inference_does_not_tell_is_measured(node: onnx.NodeProto, kernel: tuple[int, ...], count: int) -> None:
    graph = Graph(of_unknown_size([node], {"w": small.weights(*kernel)}, "y"))
    assert not all(isinstance(dim, int) for dim in graph.shape("hidden") or [None])
    assert sum(macs(graph)) == count


def test_a_convnext_block_forward_and_backward() -> None:
    """The adjoint of every product costs what it does; then 48 magnitudes of a cell are put in their 16 pixels."""
    saliency = build_saliency(small.convnext(), "y", [], "x", Preprocessing())
    forward = 8 * 3 * 4 * 4 + 8 * 7 * 7 + 8 * 16 + 16 * 8
    by_hand = (2 * forward + 48 * 4 * 4) / 16
    assert macs_per_pixel(saliency, ["saliency"]) == pytest.approx(by_hand, rel=0.01)


def test_a_model_that_does_not_run_is_an_export_error() -> None:
    node = helper.make_node("MatMul", ["hidden", "w"], ["y"])
    graph = Graph(of_unknown_size([node], {"w": small.weights(5, 7)}, "y"))
    with pytest.raises(ExportError, match="the model does not run on an image of zeros"):
        sizes_of(graph, ["y"])


def test_an_error_without_a_text_is_called_by_its_type(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("elf_export.graph.cost.open_session", refuse)
    node = helper.make_node("MatMul", ["hidden", "w"], ["y"])
    graph = Graph(of_unknown_size([node], {"w": small.weights(4, 7)}, "y"))
    with pytest.raises(ExportError, match=r"does not run on an image of zeros: MemoryError$"):
        sizes_of(graph, ["y"])
