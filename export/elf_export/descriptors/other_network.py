"""Descriptor maps of another network in the detector's file: ``--net superpoint --desc vgg:pool3``.

Each network keeps its own preprocessing; both start from one image input, and what they compute alike is
computed once.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import onnx
from onnx import TensorProto, helper

from elf_export.errors import LayerError
from elf_export.graph.graph import Graph
from elf_export.graph.passes import cut, fold_batchnorm, fold_constants, share
from elf_export.preprocessing import Preprocessing, prepend
from elf_export.saliency import IMAGE, check, descriptor_output


def attach(
    model: onnx.ModelProto,
    forward: onnx.ModelProto,
    image: str,
    network: str,
    layers: Sequence[str],
    preprocessing: Preprocessing,
    color: str,
) -> onnx.ModelProto:
    """A copy of `model` with the maps of another network's `layers` as further outputs.

    Parameters
    ----------
    model : onnx.ModelProto
        As `build_saliency` makes it, with an image input of the colour order `color`.
    forward : onnx.ModelProto
        The other network, whose input is called `image`; its values get ``NETWORK/`` in front of their names, or
        ``NETWORK_2/`` where the model has names of that scope.
    """
    prefix = _prefix(model, network)
    graph = fold_batchnorm(fold_constants(Graph(cut(forward, layers), copy=False)), keep=layers)
    outputs = []
    for layer in layers:
        out = descriptor_output(f"{network}:{layer}")
        if any(value.name == out for value in model.graph.output):
            raise LayerError(f"two descriptor layers would both be the output {out!r}; export them one by one")
        channels = (graph.shape(layer) or [None] * 4)[1]
        graph.op("Transpose", layer, name=f"descriptors/{layer}", outputs=[out], perm=[0, 2, 3, 1])
        dims = ["N", f"h_{out}", f"w_{out}", channels]
        outputs.append(helper.make_tensor_value_info(out, TensorProto.FLOAT, dims))
    prepend(graph, image, preprocessing, IMAGE, color)

    kept = {"", IMAGE, *(value.name for value in outputs)}
    for node in graph.model.graph.node:
        node.name = f"{prefix}{node.name}"
        for names in (node.input, node.output):
            names[:] = [name if name in kept else f"{prefix}{name}" for name in names]
    for tensor in graph.model.graph.initializer:
        tensor.name = f"{prefix}{tensor.name}"

    joined = onnx.ModelProto()
    joined.CopyFrom(model)
    joined.graph.node.extend(graph.model.graph.node)
    joined.graph.initializer.extend(graph.model.graph.initializer)
    joined.graph.output.extend(outputs)
    joined = share(Graph(joined, copy=False)).model
    del joined.graph.value_info[:]
    check(joined)
    return joined


def _prefix(model: onnx.ModelProto, network: str) -> str:
    """``NETWORK/``, or one with a number that no name of the model begins with."""
    names = {name for node in model.graph.node for name in (node.name, *node.output)}
    names |= {value.name for value in (*model.graph.initializer, *model.graph.input)}
    prefixes = (f"{network}{number}/" for number in itertools.chain([""], (f"_{i}" for i in itertools.count(2))))
    return next(prefix for prefix in prefixes if not any(name.startswith(prefix) for name in names))
