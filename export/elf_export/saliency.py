"""The saliency graph: forward, adjoint, absolute value, channel mean; preprocessing in front."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper

from .adjoint import build_adjoint
from .errors import ExportError, LayerError
from .graph.axes import axes_of
from .graph.cost import PROBE, fix_sizes, sizes_where_known
from .graph.graph import Graph, GraphView, defined_in, nested_graphs, reduce_mean
from .graph.layout import image_layout, only_image_input
from .graph.passes import (
    compose_convs,
    cut,
    expand_response,
    fold_batchnorm,
    fold_constants,
    rename_values,
    share_row_maxima,
    standard_ops,
)
from .graph.shapes import without_weights
from .lowering import lower, write_steps
from .preprocessing import Preprocessing, prepend

IMAGE, SALIENCY, GRADIENT = "image", "saliency", "gradient"
LEAST = 32  # pixels of height and width from which on a graph runs where nothing else is asked for

Seed = npt.NDArray[np.floating] | str | None
"""None: F itself.  An array: a constant, broadcast to F.  A name: a new float32 input of the graph."""


def build_saliency(
    model: onnx.ModelProto,
    layer: str,
    descriptors: Sequence[str] = (),
    image_input: str | None = None,
    preprocessing: Preprocessing | None = None,
    seed: Seed = None,
    differentiate: bool = True,
    color: str | None = None,
    lowering: str = "fast",
    min_size: int = LEAST,
    size: int = PROBE,
    masks: bool = False,
) -> onnx.ModelProto:
    """A model whose outputs are S(I) = |seed^T dF/dI|, averaged over I's channels, and descriptor maps.

    F is the value `layer` of `model`; its input-gradient is built explicitly, from standard ONNX ops.  Useful
    beyond keypoints wherever an input gradient is wanted without an autograd engine.

    Parameters
    ----------
    model : onnx.ModelProto
        A network with an image input (N, C, H, W) or (N, H, W, C).
    layer : str
        Name of the value F, of any shape.
    descriptors : names of values (N, D, h, w) or (N, h, w, D)
        Each becomes an output ``descriptors_NAME`` of shape (N, h, w, D).
    image_input : str, optional
        Name of the image input; the only input of rank 4 by default.  It keeps that name, unless an output has it.
    preprocessing : Preprocessing, optional
        Put in front, the input then being ``image``, raw pixels (N, H, W, C); None leaves the model's own input.
    seed : array or str, optional
        F by default, which gives ELF's |F^T dF/dI|.  An array is a constant that is broadcast to F: a one-hot
        row gives the saliency of a class.  A name adds a graph input of that name, fed at run time.
    differentiate : bool
        False takes F itself for the gradient: a saliency map that the model computes already.
    color : "bgr", "rgb" or "gray", optional
        Colour order of the raw pixels, if it is not that of `preprocessing`.
    lowering : "fast", "int8" or "plain"
        The form that the gradient is written in, the values being the same: fast for floats, for what is to be rounded
        to 8 bits, or with nothing clever, to be read and for runtimes that stumble over the others.
    min_size : int
        Smallest height and width, in pixels, that the result must run on; what is faster on large images only
        is left out where it would not.
    size : int
        A usual height and width that `model` takes, at which the axes of its maps are told.
    masks : bool
        Leave the masks in operations of `dialect`, for a pass of `precision` to write.

    Returns
    -------
    onnx.ModelProto
        Outputs ``saliency`` (N, H, W) and ``descriptors_NAME``; inputs of any N, H, W, from `min_size` on, that
        `model` takes.

    Raises
    ------
    LayerError
        If a layer is not in the model, or does not depend on the image, or a descriptor is no map.
    UnsupportedGraphError
        If a node on the way has no adjoint; all of them are listed.
    ExportError
        If onnx's checker refuses the result.
    """
    ours = {SALIENCY, *map(descriptor_output, descriptors)} | ({IMAGE} if preprocessing is not None else set())
    graph, names, image, gradient = _differentiated(model, layer, descriptors, image_input, seed, differentiate, ours)
    layout = image_layout(graph, image)
    magnitude = graph.op("Abs", gradient, name=f"{SALIENCY}/abs")
    reduce_mean(graph, magnitude, layout.index("C"), f"{SALIENCY}/mean", keepdims=0, output=SALIENCY)
    outputs = [helper.make_tensor_value_info(SALIENCY, graph.elem_type(image), ["N", "H", "W"])]
    outputs += descriptor_outputs(graph, {name: names.get(name, name) for name in descriptors}, image, layout, size)
    graph.set_outputs(outputs)
    lower(graph, lowering)
    smallest = without_weights(graph.model)
    if graph.rank(image) == len(layout):
        fix_sizes(smallest, image, layout, min_size)
    compose_convs(graph, smallest=GraphView(smallest))
    share_row_maxima(expand_response(graph))
    if preprocessing is not None:
        prepend(graph, image, preprocessing, IMAGE, color, layout)
    return _finished(graph if masks else write_steps(graph, lowering), outputs)


def build_gradient(
    model: onnx.ModelProto, layer: str, image_input: str | None = None, seed: Seed = None
) -> onnx.ModelProto:
    """A model whose outputs are F, under its own name, and ``gradient``, seed^T dF/dI with its sign.

    The gradient has the image's shape and layout.  Parameters and errors are those of `build_saliency`.  A value of
    the model's that is called ``gradient``, be it F or the image, gets a number behind its name.
    """
    graph, names, image, gradient = _differentiated(model, layer, (), image_input, seed, True, {GRADIENT})
    layer = names.get(layer, layer)
    graph.op("Identity", gradient, name="gradient/output", outputs=[GRADIENT])
    outputs = [
        helper.make_tensor_value_info(layer, graph.elem_type(layer), graph.shape(layer)),
        helper.make_tensor_value_info(GRADIENT, graph.elem_type(image), graph.shape(image)),
    ]
    graph.set_outputs(outputs)
    return _finished(write_steps(lower(graph)), outputs)


def _differentiated(
    model: onnx.ModelProto,
    layer: str,
    descriptors: Sequence[str],
    image_input: str | None,
    seed: Seed,
    differentiate: bool,
    ours: Collection[str],
) -> tuple[Graph, Mapping[str, str], str, str]:
    """The trunk of `model` with the adjoint appended, the names that it got, the image's and the gradient's.

    `ours` are the names that no value of the model may have; those that do are called otherwise, old name -> new one.
    """
    wanted = list(dict.fromkeys([layer, *descriptors]))
    try:
        graph = standard_ops(Graph(cut(model, wanted), copy=False))
    except KeyError as error:
        raise LayerError(f"the model has no value {error.args[0]!r}") from None
    names = make_way(graph, ours)
    layer, wanted = names.get(layer, layer), [names.get(name, name) for name in wanted]
    fold_batchnorm(fold_constants(graph), keep=wanted)
    image = names.get(image_input, image_input) if image_input else only_image_input(graph)
    if not differentiate:
        return graph, names, image, layer
    return graph, names, image, build_adjoint(graph, layer, image, _seed_value(graph, layer, seed, ours))


def make_way(graph: Graph, ours: Collection[str]) -> dict[str, str]:
    """Call those of the model's values that have one of our names otherwise: old name -> new one."""
    values = {name for scope in nested_graphs(graph.model.graph) for name in defined_in(scope)}
    names = {name: graph.unique(name) for name in sorted(values.intersection(ours))}
    if names:
        rename_values(graph, names)
    return names


def _seed_value(graph: Graph, layer: str, seed: Seed, ours: Collection[str]) -> str | None:
    if seed is None:
        return None
    if isinstance(seed, str):
        taken = {*graph.inputs, *graph.producers(), *ours}
        if seed in taken:
            raise LayerError(f"the seed's input can't be called {seed!r}: another value has that name")
        shape = graph.shape(layer)
        graph.model.graph.input.append(helper.make_tensor_value_info(seed, graph.elem_type(layer), shape))
        return seed
    value = graph.const(seed, "seed/value", graph.dtype(layer))
    return graph.op("Expand", value, graph.op("Shape", layer, name="seed/shape"), name="seed/expanded")


def descriptor_outputs(
    graph: Graph, layers: Mapping[str, str], image: str, layout: str, size: int
) -> list[onnx.ValueInfoProto]:
    """Append what turns each descriptor layer into (N, h, w, D), and describe the outputs.

    `layers` are the values by the names that the file gives them; `image` has the axes `layout`.
    """
    outputs: list[onnx.ValueInfoProto] = []
    if not layers:
        return outputs
    trunk = graph.part(list(layers.values()))
    if graph.rank(image) == len(layout):
        fix_sizes(trunk, image, layout, size)
    probe = GraphView(trunk)
    sizes = sizes_where_known(probe)
    axes = axes_of(probe, image, layout, sizes)
    for name, source in layers.items():
        if source not in axes:
            shape = graph.shape(source)
            raise LayerError(f"{name!r} can't describe keypoints: it is no map (N, D, h, w) of the image, but {shape}")
        out = descriptor_output(name)
        if any(value.name == out for value in outputs):
            raise LayerError(f"two descriptor layers would both be the output {out!r}; export them one by one")
        perm = [axes[source].index(a) for a in "NHWC"]
        dim = sizes[source][perm[3]] if source in sizes else None
        graph.op("Transpose", source, name=f"descriptors/{name}", outputs=[out], perm=perm)
        dims = ["N", f"h_{name}", f"w_{name}", dim]
        outputs.append(helper.make_tensor_value_info(out, graph.elem_type(source), dims))
    return outputs


def _finished(graph: Graph, outputs: Sequence[onnx.ValueInfoProto]) -> onnx.ModelProto:
    graph.set_outputs(outputs)
    del graph.model.graph.value_info[:]
    check(graph.model)
    return graph.model


def check(model: onnx.ModelProto) -> None:
    """Raise ExportError if onnx's checker refuses the model."""
    try:
        onnx.checker.check_model(model, full_check=True)
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
        raise ExportError(
            f"onnx {onnx.__version__} refuses the graph that was built from this model: {str(error).strip()}.  That is "
            "the exporter's fault; please report it, with the model"
        ) from error


def descriptor_output(layer: str) -> str:
    """Name of the output that carries `layer`'s map."""
    return "descriptors_" + "".join(c if c.isalnum() or c == "_" else "_" for c in layer)
