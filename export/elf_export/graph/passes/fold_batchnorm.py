"""Fold an inference BatchNormalization into the Conv before it."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from elf_export.graph.graph import Graph, attributes


def fold_batchnorm(graph: Graph, keep: Collection[str] = ()) -> Graph:
    """BN(W * x + b) = (f W) * x + f (b - mean) + bias with f = scale / sqrt(var + eps), per output channel.

    requires : constant weights; `keep` are values that are asked for, such as a layer.
    call : behind `fold_constants`, which finds more constants.
    ensures : no BatchNormalization behind a Conv that nothing else reads and that is not in `keep`; the convolution
        makes the value that it made.
    """
    for bn in list(graph.nodes):
        conv = graph.producers().get(bn.input[0]) if bn.op_type == "BatchNormalization" else None
        if conv is None or conv.op_type != "Conv" or attributes(bn).get("training_mode", 0):
            continue
        middle = conv.output[0]
        if middle in keep or middle in graph.outputs or len(graph.consumers()[middle]) > 1:
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
        graph.remove(bn)
        graph.rewire(conv, [conv.input[0], *names], [bn.output[0]])
    graph.prune()
    return graph
