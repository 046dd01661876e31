"""The saliency graph: forward, adjoint, absolute value, channel mean; preprocessing in front."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import onnx
from onnx import TensorProto, helper

from .adjoint import build_adjoint
from .errors import LayerError
from .graph import Graph, reduce_mean
from .passes import compose_convs, cut, fold_batchnorm, fold_constants
from .preprocessing import Preprocessing, prepend

IMAGE, SALIENCY = "image", "saliency"


def build_saliency(
    model: onnx.ModelProto,
    layer: str,
    descriptors: Sequence[str] = (),
    image_input: str | None = None,
    preprocessing: Preprocessing | None = None,
    differentiate: bool = True,
    color: str | None = None,
) -> onnx.ModelProto:
    """A model whose outputs are S(I) = |F^T dF/dI|, averaged over I's channels, and descriptor maps.

    F is the value `layer` of `model`; its input-gradient is built explicitly, from standard ONNX ops.  Useful
    beyond keypoints wherever an input gradient is wanted without an autograd engine.

    Parameters
    ----------
    model : onnx.ModelProto
        A network with an image input (N, C, H, W).
    layer : str
        Name of the value F.
    descriptors : names of values (N, D, h, w)
        Each becomes an output ``descriptors_NAME`` of shape (N, h, w, D).
    image_input : str, optional
        Name of the image input; the only input by default.
    preprocessing : Preprocessing, optional
        Put in front, the input then being ``image``, raw pixels (N, H, W, C); None leaves the model's own input.
    differentiate : bool
        False takes F itself for the gradient: a saliency map that the model computes already.
    color : "bgr", "rgb" or "gray", optional
        Colour order of the raw pixels, if it is not that of `preprocessing`.

    Returns
    -------
    onnx.ModelProto
        Outputs ``saliency`` (N, H, W) and ``descriptors_NAME``; inputs of any N, H, W that `model` takes.

    Raises
    ------
    LayerError
        If a layer is not in the model, or does not depend on the image.
    UnsupportedGraphError
        If a node on the way has no adjoint; all of them are listed.
    """
    wanted = list(dict.fromkeys([layer, *descriptors]))
    try:
        trunk = cut(model, wanted)
    except KeyError as error:
        raise LayerError(f"the model has no value {error.args[0]!r}") from None
    trunk = fold_batchnorm(fold_constants(trunk), keep=wanted)
    graph = Graph(trunk)
    image = image_input or only_image_input(graph)

    gradient = build_adjoint(graph, layer, image) if differentiate else layer
    magnitude = graph.op("Abs", gradient, name="saliency/abs")
    reduce_mean(graph, magnitude, 1, "saliency/mean", keepdims=0, output=SALIENCY)
    outputs = [helper.make_tensor_value_info(SALIENCY, TensorProto.FLOAT, ["N", "H", "W"])]
    for name in descriptors:
        dims = graph.shape(name) or [None] * 4
        out = descriptor_output(name)
        graph.op("Transpose", name, name=f"descriptors/{name}", outputs=[out], perm=[0, 2, 3, 1])
        outputs.append(helper.make_tensor_value_info(out, TensorProto.FLOAT, ["N", f"h_{name}", f"w_{name}", dims[1]]))
    stated = [value.name for value in outputs]
    del graph.model.graph.output[:]
    graph.model.graph.output.extend(outputs)
    graph = Graph(compose_convs(graph.model, keep=stated))
    if preprocessing is not None:
        prepend(graph, image, preprocessing, IMAGE, color)
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
    found = [v.name for v in graph.model.graph.input if graph.rank(v.name) == 4 and not graph.is_constant(v.name)]
    if len(found) != 1:
        names = [v.name for v in graph.model.graph.input]
        raise LayerError(f"which input is the image? The model takes {names}; name it")
    return str(found[0])


def stamp(model: onnx.ModelProto, metadata: Mapping[str, str]) -> None:
    """Replace the model's metadata by `metadata`."""
    helper.set_model_props(model, dict(metadata))
