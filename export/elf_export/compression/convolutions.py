"""The convolutions of a forward graph that low rank can make cheaper, and samples of what they give on photographs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import onnx

from elf_export.errors import ExportError, LayerError
from elf_export.graph.graph import Graph, attributes
from elf_runtime.model.session import open_session

Array = npt.NDArray[np.float32]

MOST_CELLS = 40_000  # of all images together, for each convolution
IMAGE_CHANNELS = 4  # a first convolution has few inputs and is cheap, and all else stands on it
SHOWN = 12


@dataclass(frozen=True)
class Convolution:
    """A Conv y = W x + b of one group with constant weights.

    Attributes
    ----------
    name : str
        As users know it.
    result : str
        The value y.
    kernel : (D, C, kh, kw)
    bias : (D,)
    rectified : bool
        Nothing but ReLUs reads y.
    """

    name: str
    result: str
    kernel: Array
    bias: Array
    rectified: bool

    @property
    def channels(self) -> int:
        return len(self.kernel)

    @property
    def per_cell(self) -> int:
        """Multiply-adds of one cell of y."""
        return int(self.kernel.size)

    @property
    def per_rank(self) -> int:
        """Multiply-adds of one cell of y for each channel of rank."""
        return int(np.prod(self.kernel.shape[1:])) + self.channels


def convolutions(graph: Graph, keep: Sequence[str]) -> list[Convolution]:
    """Those in the graph's order that may be compressed; `keep` are values that are asked for."""
    found = []
    for node in graph.nodes:
        if node.op_type != "Conv" or attributes(node).get("group", 1) != 1 or graph.dtype(node.output[0]) != np.float32:
            continue
        kernel = graph.constant(node.input[1])
        given = node.input[2] if len(node.input) > 2 else ""
        bias = graph.constant(given) if given else np.zeros(len(kernel) if kernel is not None else 0, np.float32)
        if kernel is None or kernel.ndim != 4 or bias is None or kernel.shape[1] < IMAGE_CHANNELS:
            continue
        result = node.output[0]
        readers = graph.consumers().get(result, ())
        rectified = result not in keep and bool(readers) and all(r.op_type == "Relu" for r in readers)
        conv = Convolution(_name(node), result, kernel, bias, rectified)
        if conv.per_rank < conv.per_cell:
            found.append(conv)
    return found


def _name(node: onnx.NodeProto) -> str:
    """The trained tensor's name without its end, as torch writes them; else the node's, or its result's."""
    weight = str(node.input[1]).removesuffix("/folded")
    if weight.endswith(".weight"):
        return weight.removesuffix(".weight")
    return str(node.name or node.output[0])


def named(found: Sequence[Convolution], graph: Graph, wanted: str) -> Convolution:
    """The convolution that `wanted` names: its name, its node's, its result's, or a unique end of one.

    Raises
    ------
    LayerError
        If there is none, or more than one.
    """
    names = {c.result: (c.name, str(graph.producers()[c.result].name), c.result) for c in found}
    exact = [c for c in found if wanted in names[c.result]]
    ends = exact or [c for c in found if any(name.endswith(wanted) for name in names[c.result])]
    if len(ends) == 1:
        return ends[0]
    known = ", ".join(c.name for c in found[:SHOWN]) + (f" and {len(found) - SHOWN} more" * (len(found) > SHOWN))
    what = f"the end of {len(ends)} convolutions' names" if ends else "no convolution that can be compressed"
    raise LayerError(f"--compress {wanted!r} is {what}; there are {known}")


@dataclass(frozen=True)
class Samples:
    """Responses of convolutions over all images.

    Attributes
    ----------
    rows : mapping
        Result -> (n, D) float32, at places drawn at random: even steps would meet one corner of each pooling window.
    cells : mapping
        Result -> cells of its map, mean over the images.
    """

    rows: Mapping[str, Array]
    cells: Mapping[str, float]


def responses(
    graph: Graph, results: Sequence[str], image: str, pictures: Callable[[], Iterable[Array]], count: int
) -> Samples:
    """What the convolutions `results` give; the same places for the same images whenever they are asked for.

    Parameters
    ----------
    image : str
        The input that takes `pictures`, of which there are `count`.

    Raises
    ------
    ExportError
        Where it is not finite.
    """
    part = graph.part(results)
    for value in part.graph.output:
        value.type.tensor_type.ClearField("shape")
    session, _ = open_session(part.SerializeToString())
    rows: dict[str, list[Array]] = {name: [] for name in results}
    sizes: dict[str, list[int]] = {name: [] for name in results}
    for index, pixels in enumerate(pictures()):
        for name, found in zip(results, session.run(list(results), {image: pixels}), strict=True):
            cells = found.transpose(0, 2, 3, 1).reshape(-1, found.shape[1])
            drawn = np.random.default_rng(index).permutation(len(cells))[: MOST_CELLS // count]
            rows[name].append(cells[drawn])
            sizes[name].append(len(cells))
            if not np.isfinite(rows[name][-1]).all():
                raise ExportError(f"--compress: the convolution {name!r} gives values that are not finite")
    return Samples(
        {name: np.concatenate(parts) for name, parts in rows.items()},
        {name: float(np.mean(counts)) for name, counts in sizes.items()},
    )
