"""`--list`: the layers of a network, with what a user chooses by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnx
from onnx import helper

from .cost import PROBE, macs_per_pixel
from .forward import NETWORK_INPUT, torch_to_onnx
from .graph import Graph
from .networks import Network
from .receptive_field import receptive_fields


def network_table(network: Network) -> str:
    """The layers of a named network; its weights are not needed for that."""
    shapes = network.tensor_shapes(network.layers)
    module = network.build({name: np.zeros(s, np.float32) for name, s in shapes.items()}, network.layers)
    model = torch_to_onnx(module, network.layers, network.preprocessing.channels)
    return layer_table(model, NETWORK_INPUT, network.layers)


def layer_table(model: onnx.ModelProto, image: str, layers: Sequence[str]) -> str:
    """Channels, stride, receptive field and forward arithmetic (share of the deepest's) of each layer."""
    graph = Graph(model)
    fields = receptive_fields(model, image)
    macs = {layer: _forward_macs(model, layer) for layer in layers}
    most = max(macs.values(), default=0.0) or 1.0
    rows = [f"{'layer':<24}{'channels':>9}{'stride':>8}{'receptive field':>17}{'forward arithmetic':>20}"]
    for layer in layers:
        shape, field = graph.shape(layer) or [], fields[layer]
        channels = shape[1] if len(shape) > 1 else "?"
        rows.append(f"{layer:<24}{channels!s:>9}{field.stride:>8g}{field.size:>14g} px{macs[layer] / most:>20.1%}")
    return "\n".join(rows)


def _forward_macs(model: onnx.ModelProto, layer: str) -> float:
    """Multiply-adds per pixel up to `layer`, for a model with an (N, C, H, W) input."""
    fixed = onnx.ModelProto()
    fixed.CopyFrom(model)
    image = fixed.graph.input[0]
    channels = image.type.tensor_type.shape.dim[1].dim_value
    image.CopyFrom(helper.make_tensor_value_info(image.name, 1, [1, channels, PROBE, PROBE]))
    return macs_per_pixel(fixed, [layer])
