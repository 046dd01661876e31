"""Descriptor maps of another network in the detector's file: ``--net superpoint --desc vgg:pool3``.

So are those of the detector's own network, where it sees the image at another scale or has another pooling to describe.
Each network keeps its own preprocessing; both start from one image input, and what they compute alike is
computed once.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import onnx

from elf_export.errors import LayerError
from elf_export.graph.graph import Graph
from elf_export.graph.image_input import ImageInput
from elf_export.graph.passes import cut, fold_batchnorm, fold_constants, share
from elf_export.preprocessing import Preprocessing, prepend
from elf_export.saliency import IMAGE, check, descriptor_output, descriptor_outputs, make_way


def attach(
    model: onnx.ModelProto,
    forward: onnx.ModelProto,
    image: ImageInput,
    network: str,
    labels: Mapping[str, str],
    preprocessing: Preprocessing,
    color: str,
    size: int,
) -> onnx.ModelProto:
    """A copy of `model` with the maps of another network's layers as further outputs.

    Parameters
    ----------
    model : onnx.ModelProto
        As `build_saliency` makes it, with an image input of the colour order `color`.
    forward : onnx.ModelProto
        The other network; its values get ``NETWORK/`` in front of their names, or ``NETWORK_2/`` where the model has
        names of that scope.
    labels : mapping
        Its layers -> what the file calls them.
    size : int
        A usual height and width, at which the axes of its maps are told.
    """
    prefix = _prefix(model, network)
    graph = Graph(cut(forward, list(labels)), copy=False)
    names = make_way(graph, {IMAGE, *map(descriptor_output, labels.values())})
    layers, source = [names.get(layer, layer) for layer in labels], names.get(image.name, image.name)
    fold_batchnorm(fold_constants(graph), keep=layers)
    for label in labels.values():
        if any(value.name == descriptor_output(label) for value in model.graph.output):
            raise LayerError(
                f"two descriptor layers would both be the output {descriptor_output(label)!r}; export them one by one"
            )
    outputs = descriptor_outputs(graph, dict(zip(labels.values(), layers, strict=True)), source, image.layout, size)
    prepend(graph, source, preprocessing, IMAGE, color, image.layout)

    kept = {"", IMAGE, *(value.name for value in outputs)}
    for node in graph.model.graph.node:
        node.name = f"{prefix}{node.name}"
        for names in (node.input, node.output):
            names[:] = [name if name in kept else f"{prefix}{name}" for name in names]
    for tensor in graph.model.graph.initializer:
        tensor.name = f"{prefix}{tensor.name}"

    base = Graph(model)
    make_way(base, [value.name for value in outputs])
    joined = base.model
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
