"""The gradients that come back to a convolution's responses, over photographs, as far as they go further back."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import numpy.typing as npt
import onnxruntime as ort
from onnx import TensorProto, helper

from elf_export.graph.graph import Graph
from elf_export.saliency import GRADIENT, build_gradient
from elf_runtime.model.session import open_session

from .convolutions import Convolution


def response_gradients(
    graph: Graph,
    conv: Convolution,
    layer: str,
    image: str,
    pictures: Callable[[], Iterable[npt.NDArray[np.float32]]],
) -> npt.NDArray[np.float64]:
    """Second moments (D, D) of K^(1/2) g over all cells; g = d(1/2 ||F||^2) / dy, y = W x + b the responses of `conv`.

    K = W W^T, (D, D), W being (D, C kh kw).  What goes back to x is W^T g, whose square is g^T K g: a direction of g
    that no kernel has is of no account, however strong it is.  Each picture counts alike.

    Parameters
    ----------
    layer : str
        F, a value that depends on y.
    image : str
        The input that takes `pictures`.
    """
    before = graph.part([conv.result])
    for value in before.graph.output:
        value.type.tensor_type.ClearField("shape")
    session, _ = open_session(before.SerializeToString())
    back = None if conv.result == layer else _gradient(graph, conv, layer)
    moments = np.zeros((conv.channels, conv.channels))
    for pixels in pictures():
        (g,) = session.run([conv.result], {image: pixels})
        if back is not None:
            feed = {image: pixels, conv.result: g}
            (g,) = back.run([GRADIENT], {value.name: feed[value.name] for value in back.get_inputs()})
        rows = g.transpose(0, 2, 3, 1).reshape(-1, conv.channels).astype(np.float64)
        moments += rows.T @ rows / max(float(np.square(rows).sum()), 1e-300)
    kernel = conv.kernel.reshape(conv.channels, -1).astype(np.float64)
    values, vectors = np.linalg.eigh(kernel @ kernel.T)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return np.asarray(root @ moments @ root)


def _gradient(graph: Graph, conv: Convolution, layer: str) -> ort.InferenceSession:
    """What gives g for y, an input now; for the image as well where F depends on it by other ways too."""
    behind = Graph(graph.part([layer]), copy=False)
    behind.remove(behind.producers()[conv.result])
    dims: list[str | int | None] = ["N", conv.channels, f"h_{conv.result}", f"w_{conv.result}"]
    behind.model.graph.input.append(helper.make_tensor_value_info(conv.result, TensorProto.FLOAT, dims))
    behind.reindex()
    behind.prune()
    model = build_gradient(behind.model, layer, conv.result)
    for value in model.graph.output:
        value.type.tensor_type.ClearField("shape")
    return open_session(model.SerializeToString())[0]
