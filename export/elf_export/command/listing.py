"""`--list`: the layers of a network, with what a user chooses by."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import onnx

from elf_export.adjoint import unsupported_behind
from elf_export.graph.axes import axes_of
from elf_export.graph.cost import counted_values, fix_sizes, node_macs, sizes_where_known
from elf_export.graph.graph import Graph, GraphView
from elf_export.graph.layout import image_layout
from elf_export.graph.passes import fold_constants
from elf_export.graph.receptive_field import Field, measured, receptive_fields
from elf_export.sources.forward import NETWORK_INPUT, torch_to_onnx
from elf_export.sources.networks import Network
from elf_runtime.errors import printable

# What makes no layer of its own: helpers, and the parts that exporters write an activation in.
NO_LAYERS = frozenset(
    {"Identity", "Cast", "Constant", "Transpose", "Pad", "Slice", "Sigmoid", "HardSigmoid", "Dropout"}
)


def network_table(network: Network) -> str:
    """The layers of a named network; its weights are not needed for that."""
    shapes = network.tensor_shapes(network.layers)
    module = network.build({name: np.zeros(s, np.float32) for name, s in shapes.items()}, network.layers)
    model = torch_to_onnx(module, network.layers, network.preprocessing.channels)
    return layer_table(model, NETWORK_INPUT, network.layers)


def layer_table(
    model: onnx.ModelProto,
    image: str,
    layers: Sequence[str] | None = None,
    fields: Mapping[str, Field] | None = None,
) -> str:
    """Shape, stride, receptive field and forward arithmetic (share of the deepest's) of each layer.

    Parameters
    ----------
    layers : names of values, optional
        By default all maps of the image that a layer's node makes; those behind an op without an adjoint, and those
        of other values than floats, are marked.
    fields : optional
        The layers' geometry, where it is known better than at the model's size.
    """
    fixed = onnx.ModelProto()
    fixed.CopyFrom(fold_constants(Graph(model)).model)
    layout = image_layout(GraphView(fixed), image)
    height, width = fix_sizes(fixed, image, layout)
    graph = Graph(fixed, copy=False)
    own_fields = receptive_fields(graph.model, image)
    sizes = sizes_where_known(graph)
    axes = axes_of(graph, image, layout, sizes)
    blocked = _blocked(graph, image)
    shown = list(layers) if layers is not None else _candidates(graph, axes, sizes)
    macs = _forward_macs(graph, shown, sizes)
    most = max((cost for cost in macs.values() if math.isfinite(cost)), default=0.0) or 1.0
    widest = max([len("layer"), *(len(printable(layer)) for layer in shown)])
    rows = [
        f"shapes and arithmetic at {width}x{height} pixels",
        f"{'layer':<{widest}}  {'op':<18}{'channels':>9}{'map':>10}{'stride':>8}{'receptive field':>17}"
        f"{'forward arithmetic':>20}",
    ]
    ops = {name: printable(node.op_type) for node in graph.nodes for name in node.output}
    for layer in shown:
        field, known = own_fields[layer], _sizes(layer, axes, sizes)
        if fields is not None and layer in fields:
            field = fields[layer]
        elif known.get("H") and known.get("W"):
            field = measured(field, (height, width), (known["H"], known["W"]))
        seen = "?" if math.isnan(field.size) else f"{field.size:g} px" if math.isfinite(field.size) else "the image"
        channels, across, down = (known.get(axis, "?") for axis in "CWH")
        share = f"{macs[layer] / most:.1%}" if math.isfinite(macs[layer]) else "?"
        row = (
            f"{printable(layer):<{widest}}  {ops[layer]:<18}{channels:>9}{f'{across}x{down}':>10}{field.stride:>8.4g}"
            f"{seen:>17}{share:>20}"
        )
        kind = graph.dtype(layer)
        if kind.kind != "f":
            row += f"  {kind} values: no keypoints or descriptors from it"
        elif layer in blocked:
            row += f"  no gradient through {blocked[layer]}"
        rows.append(row)
    return "\n".join(rows)


def map_layers(model: onnx.ModelProto, image: str) -> list[str]:
    """The layers that `layer_table` shows by default, of a model whose image has a fixed size."""
    graph = fold_constants(Graph(model))
    sizes = sizes_where_known(graph)
    return _candidates(graph, axes_of(graph, image, image_layout(graph, image), sizes), sizes)


def _sizes(layer: str, axes: Mapping[str, str], sizes: Mapping[str, Sequence[int]]) -> dict[str, int]:
    return dict(zip(axes.get(layer, "NCHW"), sizes.get(layer, ()), strict=False))


def _candidates(graph: GraphView, axes: Mapping[str, str], sizes: Mapping[str, Sequence[int]]) -> list[str]:
    """Maps of more than one cell, but for the ends of NO_LAYERS."""
    found = []
    for node in graph.nodes:
        name = node.output[0] if node.output else ""
        if name not in axes or node.op_type in NO_LAYERS:
            continue
        known = _sizes(name, axes, sizes)
        if (known.get("H"), known.get("W")) != (1, 1):
            found.append(name)
    return found


def _blocked(graph: Graph, image: str) -> dict[str, str]:
    """Values that depend on the image through a node without an adjoint, and that node's op."""
    reached = {image}
    blocked: dict[str, str] = {}
    reasons = unsupported_behind(graph, image)
    for node in graph.nodes:
        arriving = [name for name in node.input if name in reached]
        if not arriving:
            continue
        reached.update(node.output)
        stops = [blocked[name] for name in arriving if name in blocked]
        if node.output[0] in reasons:
            stops = [node.op_type]
        if stops:
            blocked.update((name, stops[0]) for name in node.output)
    return blocked


def _forward_macs(graph: GraphView, layers: Sequence[str], sizes: Mapping[str, Sequence[int]]) -> dict[str, float]:
    """Multiply-adds of all that each layer needs; NaN where a size is not known."""
    costs = [
        node_macs(sizes, node) if sizes.keys() >= set(counted_values([node])) else math.nan for node in graph.nodes
    ]
    # A set of nodes as the bits of an integer: a value needs its maker's bit and those of the maker's inputs.
    needs: dict[str, int] = {}
    for i, node in enumerate(graph.nodes):
        bits = 1 << i
        for name in node.input:
            bits |= needs.get(name, 0)
        needs.update((name, bits) for name in node.output)
    paid = [(i, cost) for i, cost in enumerate(costs) if cost]
    return {layer: sum(cost for i, cost in paid if needs[layer] >> i & 1) for layer in layers}
