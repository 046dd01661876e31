"""From a torch module to its ONNX graph, with layer names that a user knows."""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import onnx

from elf_export.errors import ExportError
from elf_export.graph.passes.convert_opset import MAX_IR_VERSION

if TYPE_CHECKING:
    import torch

DEFAULT_OPSET = 17
NETWORK_INPUT = "network_input"


def torch_to_onnx(
    module: torch.nn.Module, layers: Sequence[str], channels: int, opset: int = DEFAULT_OPSET
) -> onnx.ModelProto:
    """Export `module`, whose forward returns the maps of `layers`, for any N, H and W.

    Returns
    -------
    onnx.ModelProto
        Input ``network_input`` (N, C, H, W), outputs named like the layers.
    """
    import torch

    example = torch.zeros(2, channels, 160, 192)
    buffer: Any = io.BytesIO()  # torch's annotation knows of paths only
    axes = {NETWORK_INPUT: {0: "N", 2: "H", 3: "W"}}
    for layer in layers:
        axes[layer] = {0: "N", 2: f"h_{layer}", 3: f"w_{layer}"}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            # The tracing exporter: it writes the opset that is asked for, without a converter's detours, and
            # needs no onnxscript.
            torch.onnx.export(
                module, (example,), buffer, input_names=[NETWORK_INPUT], output_names=list(layers),
                dynamic_axes=axes, opset_version=opset, do_constant_folding=True, dynamo=False,
            )  # fmt: skip
        except Exception as error:
            raise ExportError(f"torch {torch.__version__} can't export this network: {error}") from error
    model = onnx.load_from_string(buffer.getvalue())
    model.ir_version = min(model.ir_version, MAX_IR_VERSION)
    return named(model, layers)


def named(model: onnx.ModelProto, layers: Sequence[str]) -> onnx.ModelProto:
    """Give the node that makes a layer the layer's name, so that profiles read well."""
    taken = set(layers)
    for node in model.graph.node:
        if node.output[0] in taken:
            node.name = node.output[0]
    return model
