"""The saliency graph: forward, adjoint, absolute value, channel mean; preprocessing in front."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper

from .adjoint import adjoint_parts, joining
from .adjoint.gradient import Part
from .errors import LayerError
from .graph import Graph
from .layout import axes_of, image_layout
from .passes import compose_convs, cut, expand_response, fold_batchnorm, fold_constants, share_row_maxima
from .preprocessing import Preprocessing, prepend

IMAGE, SALIENCY, GRADIENT = "image", "saliency", "gradient"

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
    channels_last: bool = False,
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
        Name of the image input; the only input of rank 4 by default.
    preprocessing : Preprocessing, optional
        Put in front, the input then being ``image``, raw pixels (N, H, W, C); None leaves the model's own input.
    seed : array or str, optional
        F by default, which gives ELF's |F^T dF/dI|.  An array is a constant that is broadcast to F: a one-hot
        row gives the saliency of a class.  A name adds a graph input of that name, fed at run time.
    differentiate : bool
        False takes F itself for the gradient: a saliency map that the model computes already.
    color : "bgr", "rgb" or "gray", optional
        Colour order of the raw pixels, if it is not that of `preprocessing`.
    channels_last : bool
        Build max-pooling's adjoint in the form that suits 8-bit convolutions; the values are the same.

    Returns
    -------
    onnx.ModelProto
        Outputs ``saliency`` (N, H, W) and ``descriptors_NAME``; inputs of any N, H, W that `model` takes.

    Raises
    ------
    LayerError
        If a layer is not in the model, or does not depend on the image, or a descriptor is no map.
    UnsupportedGraphError
        If a node on the way has no adjoint; all of them are listed.
    """
    graph, image, gradient = _differentiated(
        model, layer, descriptors, image_input, seed, differentiate, channels_last
    )
    layout = image_layout(graph, image)
    joining.mean_magnitude(graph, gradient, layout.index("C"), SALIENCY)
    outputs = [helper.make_tensor_value_info(SALIENCY, graph.elem_type(image), ["N", "H", "W"])]
    outputs += _descriptor_outputs(graph, descriptors, axes_of(graph, image, layout))
    composed = compose_convs(_with_outputs(graph, outputs), keep=[value.name for value in outputs])
    graph = Graph(share_row_maxima(expand_response(composed)))
    if preprocessing is not None:
        prepend(graph, image, preprocessing, IMAGE, color, layout)
    return _finished(graph, outputs)


def build_gradient(
    model: onnx.ModelProto, layer: str, image_input: str | None = None, seed: Seed = None
) -> onnx.ModelProto:
    """A model whose outputs are F, under its own name, and ``gradient``, seed^T dF/dI with its sign.

    The gradient has the image's shape and layout.  Parameters and errors are those of `build_saliency`.
    """
    graph, image, gradient = _differentiated(model, layer, (), image_input, seed, True)
    whole = joining.whole(graph, gradient)
    graph.op("Identity", whole, name="gradient/output", outputs=[GRADIENT])
    outputs = [
        helper.make_tensor_value_info(layer, graph.elem_type(layer), graph.shape(layer)),
        helper.make_tensor_value_info(GRADIENT, graph.elem_type(image), graph.shape(image)),
    ]
    return _finished(graph, outputs)


def _differentiated(
    model: onnx.ModelProto,
    layer: str,
    descriptors: Sequence[str],
    image_input: str | None,
    seed: Seed,
    differentiate: bool,
    channels_last: bool = False,
) -> tuple[Graph, str, Part]:
    """The trunk of `model` with the adjoint appended, the image's name and the gradient."""
    wanted = list(dict.fromkeys([layer, *descriptors]))
    try:
        trunk = cut(model, wanted)
    except KeyError as error:
        raise LayerError(f"the model has no value {error.args[0]!r}") from None
    trunk = fold_batchnorm(fold_constants(trunk), keep=wanted)
    graph = Graph(trunk)
    image = image_input or only_image_input(graph)
    if not differentiate:
        return graph, image, layer
    return graph, image, adjoint_parts(graph, layer, image, _seed_value(graph, layer, seed), channels_last)


def _seed_value(graph: Graph, layer: str, seed: Seed) -> str | None:
    if seed is None:
        return None
    if isinstance(seed, str):
        taken = {value.name for value in graph.model.graph.input} | set(graph.producers())
        if seed in taken:
            raise LayerError(f"the seed's input can't be called {seed!r}: the model has a value of that name")
        shape = graph.shape(layer)
        graph.model.graph.input.append(helper.make_tensor_value_info(seed, graph.elem_type(layer), shape))
        return seed
    value = graph.const(seed, "seed/value", graph.dtype(layer))
    return graph.op("Expand", value, graph.op("Shape", layer, name="seed/shape"), name="seed/expanded")


def _descriptor_outputs(
    graph: Graph, descriptors: Sequence[str], axes: Mapping[str, str]
) -> list[onnx.ValueInfoProto]:
    """Append what turns each descriptor layer into (N, h, w, D), and describe the outputs."""
    outputs: list[onnx.ValueInfoProto] = []
    for name in descriptors:
        if name not in axes:
            shape = graph.shape(name)
            raise LayerError(
                f"{name!r} can't describe keypoints: it is no map (N, D, h, w) of the image, but {shape}"
            )
        out = descriptor_output(name)
        if any(value.name == out for value in outputs):
            raise LayerError(
                f"two descriptor layers would both be the output {out!r}; export them one by one"
            )
        perm = [axes[name].index(a) for a in "NHWC"]
        dim = (graph.shape(name) or [None] * 4)[perm[3]]
        graph.op("Transpose", name, name=f"descriptors/{name}", outputs=[out], perm=perm)
        dims = ["N", f"h_{name}", f"w_{name}", dim]
        outputs.append(helper.make_tensor_value_info(out, graph.elem_type(name), dims))
    return outputs


def _with_outputs(graph: Graph, outputs: Sequence[onnx.ValueInfoProto]) -> onnx.ModelProto:
    del graph.model.graph.output[:]
    graph.model.graph.output.extend(outputs)
    return graph.model


def _finished(graph: Graph, outputs: Sequence[onnx.ValueInfoProto]) -> onnx.ModelProto:
    _with_outputs(graph, outputs)
    del graph.model.graph.value_info[:]
    onnx.checker.check_model(graph.model, full_check=True)
    return graph.model


def descriptor_output(layer: str) -> str:
    """Name of the output that carries `layer`'s map."""
    return "descriptors_" + "".join(c if c.isalnum() or c == "_" else "_" for c in layer)


def only_image_input(graph: Graph) -> str:
    """The graph's one 4-dimensional input.

    Raises
    ------
    LayerError
        If there is none, or several.
    """
    found = [
        v.name for v in graph.model.graph.input if graph.rank(v.name) == 4 and not graph.is_constant(v.name)
    ]
    if len(found) != 1:
        names = [v.name for v in graph.model.graph.input]
        raise LayerError(f"which input is the image? The model takes {names}; name it")
    return str(found[0])


def stamp(model: onnx.ModelProto, metadata: Mapping[str, str]) -> None:
    """Replace the model's metadata by `metadata`."""
    helper.set_model_props(model, dict(metadata))
