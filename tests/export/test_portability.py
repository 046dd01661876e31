"""Every named network's graph uses only what TensorRT and CUDA are documented to run.

No GPU is needed: the lists below are those of onnx-tensorrt's docs/operators.md and of ONNX Runtime's
docs/OperatorKernels.md, as far as the graphs need them, and the restrictions that stand beside the ops there.
"""

from __future__ import annotations

import onnx
import pytest

from elf_export.saliency import build_saliency
from elf_export.sources.forward import NETWORK_INPUT, torch_to_onnx
from elf_export.sources.networks import get_network, network_names
from elf_runtime.model import bundled_model
from seeded import seeded_weights

# Run by TensorRT (8.6 and later, opsets 9 to 20) and by the CUDA provider, for float32.
BOTH = {
    "Abs", "Add", "AveragePool", "BatchNormalization", "Cast", "Clip", "Concat", "Constant", "Conv", "ConvTranspose",
    "DepthToSpace", "Div", "Expand", "Floor", "Gather", "GlobalAveragePool", "Greater", "HardSigmoid", "HardSwish",
    "LRN", "LeakyRelu", "Max", "MaxPool", "Mul", "Pad", "Pow", "ReduceMean", "ReduceProd", "ReduceSum", "Relu",
    "Reshape", "Resize", "Round", "Shape", "Sign", "Slice", "Sqrt", "Squeeze", "Sub", "Sum", "Transpose", "Where",
}  # fmt: skip
# Input index that must be an initializer, for TensorRT.
CONSTANT_INPUTS = {"Conv": [1], "ConvTranspose": [1], "Slice": [3], "ReduceSum": [1], "Squeeze": [1], "Resize": [2]}


def graph_of(name: str) -> onnx.ModelProto:
    """The network's default detector and descriptors, with random weights."""
    network = get_network(name)
    descriptors = [layer for layer in network.default_descriptors if ":" not in layer]
    layers = list(dict.fromkeys([network.default_layer, *descriptors]))
    module = network.build(seeded_weights(network.tensor_shapes(layers), 0), layers)
    settings = network.preprocessing
    forward = torch_to_onnx(module, layers, settings.channels)
    return build_saliency(
        forward, network.default_layer, descriptors, NETWORK_INPUT, settings, differentiate=network.gradient
    )


def problems(model: onnx.ModelProto) -> list[str]:
    """What TensorRT, CUDA or OpenVINO would not run, or run wrongly."""
    found = []
    constants = {tensor.name for tensor in model.graph.initializer}
    constants |= {out for node in model.graph.node if node.op_type == "Constant" for out in node.output}
    for node in model.graph.node:
        attributes = {a.name: onnx.helper.get_attribute_value(a) for a in node.attribute}
        if node.domain or node.op_type not in BOTH:
            found.append(f"{node.name}: {node.domain}.{node.op_type}")
        found += [
            f"{node.name}: input {index} of {node.op_type} is computed"
            for index in CONSTANT_INPUTS.get(node.op_type, [])
            if len(node.input) > index and node.input[index] and node.input[index] not in constants
        ]
        if node.op_type == "MaxPool" and len(node.output) > 1:
            found.append(f"{node.name}: TensorRT's MaxPool gives no indices")
        if node.op_type in ("Conv", "ConvTranspose", "MaxPool") and len(attributes.get("strides", [1, 1])) > 3:
            found.append(f"{node.name}: more than three dimensions")
        if node.op_type == "Resize" and (
            len(node.input) > 3 or attributes.get("antialias") or attributes.get("mode") not in (b"linear", b"nearest")
        ):
            found.append(f"{node.name}: TensorRT resizes by scales, linearly or to the nearest, without antialiasing")
        # OpenVINO's provider takes an offset of 0 for the default, 0.5.
        if node.op_type == "HardSigmoid" and attributes.get("beta") == 0.0:
            found.append(f"{node.name}: HardSigmoid with beta 0")
    doubles = [t.name for t in model.graph.initializer if t.data_type == onnx.TensorProto.DOUBLE]
    return [*found, *(f"{name}: float64 is cast to float32 by TensorRT" for name in doubles)]


@pytest.mark.parametrize("name", network_names())
def test_gpu_providers_are_documented_to_run_it(name: str) -> None:
    assert problems(graph_of(name)) == []


def test_so_with_the_bundled_model() -> None:
    assert problems(onnx.load(bundled_model())) == []


def test_what_is_not_portable_is_seen() -> None:
    model = onnx.load(bundled_model())
    nodes = {node.op_type: node for node in model.graph.node}
    nodes["MaxPool"].output.append("indices")
    next(a for a in nodes["HardSigmoid"].attribute if a.name == "beta").f = 0.0
    nodes["Conv"].input[1] = "image"
    nodes["Sqrt"].op_type = "Erf2"
    next(a for a in nodes["Resize"].attribute if a.name == "mode").s = b"cubic"
    assert len(problems(model)) == 5
