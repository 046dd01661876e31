"""Fold an inference BatchNormalization into the Conv before it."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import onnx

from elf_export.graph.graph import Graph, attributes

from .cut import cut


def fold_batchnorm(model: onnx.ModelProto, keep: Collection[str] = ()) -> onnx.ModelProto:
    """BN(W * x + b) = (f W) * x + f (b - mean) + bias with f = scale / sqrt(var + eps), per output channel.

    Only where the Conv's output has no other reader and is not in `keep` (a layer that is asked for).
    """
    graph = Graph(model)
    readers, producers = graph.consumers(), graph.producers()
    outputs = {value.name for value in graph.model.graph.output}
    renamed: dict[str, str] = {}
    dropped: list[onnx.NodeProto] = []
    for bn in graph.nodes:
        conv = producers.get(bn.input[0]) if bn.op_type == "BatchNormalization" else None
        if conv is None or conv.op_type != "Conv" or attributes(bn).get("training_mode", 0):
            continue
        middle = conv.output[0]
        if middle in keep or middle in outputs or len(readers[middle]) > 1:
            continue
        weight = graph.constant(conv.input[1])
        params = [graph.constant(name) for name in bn.input[1:5]]
        has_bias = len(conv.input) > 2 and bool(conv.input[2])
        bias = graph.constant(conv.input[2]) if has_bias else np.zeros(1)
        if weight is None or bias is None or any(p is None for p in params):
            continue
        scale, shift, mean, variance = (np.asarray(p, np.float64) for p in params)
        factor = scale / np.sqrt(variance + attributes(bn).get("epsilon", 1e-5))
        new_weight = weight * factor.reshape(-1, *[1] * (weight.ndim - 1))
        new_bias = (bias.astype(np.float64) - mean) * factor + shift
        names = [
            graph.const(new_weight, f"{conv.input[1]}/folded", weight.dtype),
            graph.const(new_bias, f"{conv.name or middle}/folded_bias", weight.dtype),
        ]
        data = conv.input[0]
        del conv.input[:]
        conv.input.extend([data, *names])
        renamed[middle] = bn.output[0]
        dropped.append(bn)
    for bn in dropped:
        graph.model.graph.node.remove(bn)
    for node in graph.nodes:
        for i, name in enumerate(node.output):
            node.output[i] = renamed.get(name, name)
    return cut(graph.model, [value.name for value in graph.model.graph.output])
