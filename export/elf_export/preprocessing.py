"""Preprocessing inside the graph: raw pixels (N, H, W, C) to what the network was trained on (N, C, H, W)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from onnx import TensorProto, helper

from .graph.graph import Graph, reduce_mean

LEAST_STD = 1e-6  # of pixels in 0..255: keeps a flat image from dividing by zero


@dataclass(frozen=True)
class Preprocessing:
    """How a network wants its pixels.

    Attributes
    ----------
    color : "bgr", "rgb" or "gray"
        Colour order of the graph's input.
    standardize : bool
        (I - mean(I)) / std(I) over all pixels and channels of each image: the paper's preprocessing.
    scale : float
        Otherwise: I * scale, then (. - mean) / std per channel.
    mean, std : per channel, in the colour order of `color`
    """

    color: str = "bgr"
    standardize: bool = True
    scale: float = 1.0
    mean: Sequence[float] = (0.0,)
    std: Sequence[float] = (1.0,)

    @property
    def channels(self) -> int:
        """Of the image: 1 or 3."""
        return 1 if self.color == "gray" else 3

    def describe(self) -> str:
        """The preprocessing in words, for the contract."""
        if self.standardize:
            return f"{self.color}, (I - mean(I)) / std(I) over all pixels and channels of each image"
        mean, std = (", ".join(f"{v:g}" for v in values) for values in (self.mean, self.std))
        return f"{self.color}, (I * {self.scale:g} - [{mean}]) / [{std}]"

    def words(self) -> list[str]:
        """The options of elf-export that say the same."""
        if self.standardize:
            return ["--color", self.color, "--standardize"]
        numbers = [f"--{key}={','.join(map(repr, getattr(self, key)))}" for key in ("mean", "std")]
        return ["--color", self.color, "--scale", repr(self.scale), *numbers]


def conversion(source: str, target: str) -> npt.NDArray[np.float64]:
    """(channels of source, channels of target): what takes the pixels of one colour order to another.

    Grey is ITU-R BT.601's, as OpenCV has it: 0.299 R + 0.587 G + 0.114 B.
    """
    if source == "gray":
        return np.ones((1, 1 if target == "gray" else 3))
    if target == "gray":
        return np.array([[{"b": 0.114, "g": 0.587, "r": 0.299}[channel]] for channel in source])
    return np.array([[float(a == b) for b in target] for a in source])


def prepend(
    graph: Graph,
    target: str,
    settings: Preprocessing,
    name: str = "image",
    color: str | None = None,
    layout: str = "NCHW",
) -> None:
    """Make the value `target`, the network's input in `layout`, from a new graph input of raw pixels.

    Parameters
    ----------
    graph : Graph
        Changed in place: `target` is no input any more, `name` (N, H, W, C) is.
    color : "bgr", "rgb" or "gray", optional
        Colour order of the new input, where another network shares it; `settings.color` by default.
    """
    color = color or settings.color
    with graph.insert_before(graph.nodes[0] if graph.nodes else None):
        _append(graph, target, settings, name, color, layout)
    proto = graph.model.graph
    kept = [value for value in proto.input if value.name != target]
    sizes = dict(zip(layout, graph.shape(target) or [None] * 4, strict=True))
    fixed = [size if isinstance(size := sizes[axis], int) else axis for axis in "NHW"]
    channels = 1 if color == "gray" else 3
    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [*fixed, channels]), *kept]
    del proto.input[:]
    proto.input.extend(infos)


def _append(graph: Graph, target: str, settings: Preprocessing, name: str, color: str, layout: str) -> None:
    """Add what makes `target` of the raw pixels `name`."""
    rows = graph.int64s([0, 0, 1, -1], "pre/rows")

    def plain_mean(x: str, role: str) -> str:
        # Rows first, then their means: a float32 sum over a million pixels in one go is off by 1e-5 of itself.
        x = graph.op("Reshape", x, rows, name=f"pre/{role}_rows")
        for axis in (3, 1):
            x = reduce_mean(graph, x, axis, f"pre/{role}_{'nhwc'[axis]}", keepdims=1)
        return x

    def centred(x: str, role: str) -> tuple[str, str]:
        """x - mean(x), and mean(x).  The mean of what is left corrects the first mean's rounding.

        The first mean is made an integer: pixels are, and sums of integers are exact.  (With a common fraction, every
        addition would round the same way.)
        """
        rough = graph.op("Round", plain_mean(x, f"{role}_near"), name=f"pre/{role}_rough")
        rest = graph.op("Sub", x, rough, name=f"pre/{role}_rest")
        correction = plain_mean(rest, f"{role}_correction")
        mean = graph.op("Add", rough, correction, name=f"pre/{role}_mean")
        return graph.op("Sub", rest, correction, name=f"pre/{role}_centred"), mean

    pixels = name
    if color != settings.color:
        matrix = graph.const(conversion(color, settings.color), "pre/colors", np.float32)
        pixels = graph.op("MatMul", name, matrix, name="pre/recolored")
    if settings.standardize:
        zero_mean, _ = centred(pixels, "pixels")
        _, variance = centred(graph.op("Mul", zero_mean, zero_mean, name="pre/squared"), "squares")
        std = graph.op("Sqrt", variance, name="pre/std")
        safe = graph.op("Max", std, graph.const(LEAST_STD, "pre/least_std", np.float32), name="pre/safe_std")
        x = graph.op("Div", zero_mean, safe, name="pre/standardized")
    else:
        # (I s - m) / d = I (s / d) - m / d
        std64 = np.broadcast_to(np.asarray(settings.std, np.float64), settings.channels)
        gain = graph.const(settings.scale / std64, "pre/gain", np.float32)
        shift = graph.const(-np.asarray(settings.mean, np.float64) / std64, "pre/shift", np.float32)
        x = graph.op("Add", graph.op("Mul", pixels, gain, name="pre/scaled"), shift, name="pre/normalized")
    if layout == "NCHW":
        graph.op("Transpose", x, name="pre/nchw", outputs=[target], perm=[0, 3, 1, 2])
    else:
        graph.op("Identity", x, name="pre/nhwc", outputs=[target])
