"""Writes tiny.onnx: an ELF model of two convolutions with seeded random weights, for tests; and tiny-alone.onnx, which
gives its keypoints, and its saliency, by itself.

    conv1 (3x3, 3 -> 8) - relu1 - pool1 (2x2 max) - conv2 (3x3, 8 -> 8) - relu2

The saliency is that of ``pool1``; ``relu2`` (the default) and ``pool1`` are its descriptors.  Needs the
export half; run it from the project's root:

    PYTHONPATH=export:runtime python tests/data/make_tiny.py
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from elf_export.end_to_end.build import Form, end_to_end
from elf_export.preprocessing import Preprocessing
from elf_export.saliency import build_saliency, descriptor_output
from elf_runtime import DescriptorSpec, ModelContract, WeightsSpec

SEED = 20190901
CHANNELS = 8
PATH = Path(__file__).with_name("tiny.onnx")


def network() -> onnx.ModelProto:
    """The network itself: ``x`` (N, 3, H, W) to ``relu2`` (N, 8, H / 2, W / 2)."""
    rng = np.random.default_rng(SEED)
    tensors = []
    for name, inputs in (("conv1", 3), ("conv2", CHANNELS)):
        kernel = rng.standard_normal((CHANNELS, inputs, 3, 3)) / np.sqrt(9 * inputs)
        # Without their means the kernels answer to edges and corners, not to brightness, as trained ones do.
        kernel -= kernel.mean(axis=(2, 3), keepdims=True)
        tensors.append(numpy_helper.from_array(kernel.astype(np.float32), f"{name}.weight"))
        bias = 0.1 * rng.standard_normal(CHANNELS)
        tensors.append(numpy_helper.from_array(bias.astype(np.float32), f"{name}.bias"))

    def conv(x: str, name: str) -> onnx.NodeProto:
        inputs = [x, f"{name}.weight", f"{name}.bias"]
        return helper.make_node("Conv", inputs, [name], name=name, kernel_shape=[3, 3], pads=[1] * 4)

    nodes = [
        conv("x", "conv1"),
        helper.make_node("Relu", ["conv1"], ["relu1"], name="relu1"),
        helper.make_node("MaxPool", ["relu1"], ["pool1"], name="pool1", kernel_shape=[2, 2], strides=[2, 2]),
        conv("pool1", "conv2"),
        helper.make_node("Relu", ["conv2"], ["relu2"], name="relu2"),
    ]
    image = helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", 3, "H", "W"])
    output = helper.make_tensor_value_info("relu2", TensorProto.FLOAT, ["N", CHANNELS, "h", "w"])
    graph = helper.make_graph(nodes, "tiny", [image], [output], tensors)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def tiny() -> onnx.ModelProto:
    """The ELF model, with its contract."""
    preprocessing = Preprocessing()
    model = build_saliency(network(), "pool1", ["relu2", "pool1"], preprocessing=preprocessing)
    conv1, conv2 = 9 * 3 * CHANNELS, 9 * CHANNELS * CHANNELS / 4  # multiply-adds per image pixel
    contract = ModelContract(
        network="tiny",
        layer="pool1",
        stride=2.0,
        receptive_field=4.0,
        descriptors=tuple(
            DescriptorSpec(descriptor_output(name), name, CHANNELS, 2.0, 0.5) for name in ("relu2", "pool1")
        ),
        preprocessing=preprocessing.describe(),
        weights=WeightsSpec(source=f"random, seed {SEED}", licence="BSD-3-Clause"),
        cost={
            "params": float(9 * 3 * CHANNELS + 9 * CHANNELS**2 + 2 * CHANNELS),
            "saliency_macs_per_pixel": 2.0 * conv1,
            "descriptors_macs_per_pixel": 2.0 * conv1 + conv2,
        },
        versions={"opset": "17"},
        command="python tests/data/make_tiny.py",
    )
    onnx.helper.set_model_props(model, contract.to_metadata())
    return model


def alone(**kinds: Any) -> onnx.ModelProto:
    """The model with image in and keypoints out, in a `Form` of these kinds."""
    model, form = tiny(), Form(**kinds)
    contract = ModelContract.from_metadata({entry.key: entry.value for entry in model.metadata_props}, "tiny")
    found = end_to_end(model, contract, form)
    contract = replace(contract, descriptors=contract.descriptors[:1], end_to_end=form.spec)
    del found.metadata_props[:]
    onnx.helper.set_model_props(found, contract.to_metadata())
    return found


if __name__ == "__main__":
    onnx.save(tiny(), PATH)
    onnx.save(alone(saliency=True), PATH.with_name("tiny-alone.onnx"))
    print(f"{PATH}: {PATH.stat().st_size} bytes")
