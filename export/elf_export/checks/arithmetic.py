"""The arithmetic in which derivatives are checked: float64 where the evaluator computes what ONNX Runtime does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import onnx

from elf_export.graph.cost import macs
from elf_export.graph.graph import GraphView
from elf_export.graph.image_input import ImageInput
from elf_export.graph.sizes import Sizes, with_sizes
from elf_export.saliency import GRADIENT
from elf_runtime.model.session import open_session

from .float64 import float64_forward

Array = npt.NDArray[np.float32]
Array64 = npt.NDArray[np.float64]
Forward = Callable[[Array64], Array64]

AFFORDABLE = 2e9  # multiply-adds of one float64 pass; about half a second
SAME_FORWARD = 1e-4  # of max |F|: the float64 evaluator computes what ONNX Runtime does
TINY = 1e-8  # of the image's standard deviation: a step that float32 would drown
BENT = 1e-2  # of a change over two such steps: what it may differ from twice the first by

# Two families of directions.  The signs of g, on a random half of the pixels, see a wrong factor or place with
# a signal far above rounding; white noise sees what g lacks, but is nearly orthogonal to any g: in float32
# its derivative drowns.
SIGNS, NOISE = "signs of the gradient", "white noise"


@dataclass(frozen=True)
class Arithmetic:
    """How differences are taken in one precision, and how well they must agree.

    Attributes
    ----------
    steps : e, in standard deviations of the image for v of rms 1
        Rounding errs like 1/e, curvature and switching ReLUs like e: of two neighbouring steps that agree
        best the mean is taken, a choice that does not look at the gradient.  Where a kink within the step makes
        the slopes ahead and behind differ by more than `typical` allows, another direction is tried.
    sizes : (height, width) of the images, about
    families : of directions
    typical, largest : of the errors over all directions, the bound on the median and on each
    """

    name: str
    steps: tuple[float, ...]
    sizes: tuple[tuple[int, int], ...]
    families: tuple[str, ...]
    typical: float
    largest: float


# In float64 both sides are, so that only a kink within a step is left of the error.
FLOAT64 = Arithmetic("float64", (3e-8, 3e-7, 3e-6), ((48, 64), (53, 71)), (SIGNS, NOISE), 1e-6, 1e-3)
FLOAT32 = Arithmetic("float32", (3e-5, 1e-4, 3e-4, 1e-3), ((96, 128), (101, 141)), (SIGNS,), 5e-3, 5e-2)


def in_float32(model: onnx.ModelProto, output: str, image: str) -> Forward:
    session, _ = open_session(model.SerializeToString())

    def run(x: Array64) -> Array64:
        value: Array = session.run([output], {image: x.astype(np.float32)})[0]
        return value.astype(np.float64)

    return run


def best_arithmetic(
    forward: onnx.ModelProto, gradient: onnx.ModelProto, layer: str, image: ImageInput, sizes: Sizes
) -> tuple[Forward, Forward, Arithmetic]:
    """The forward pass and the gradient, in the best arithmetic that can be had for this model."""
    single = in_float32(forward, layer, image.name)
    its_image = gradient.graph.input[0].name
    lower = single, in_float32(gradient, GRADIENT, its_image), FLOAT32
    height, width = sizes.near(*FLOAT64.sizes[0])
    static = GraphView(with_sizes(forward, image, Sizes(height, width, 1)))
    if sum(macs(static)) > AFFORDABLE:
        return lower
    shape = [{"N": 1, "C": image.channels, "H": height, "W": width}[axis] for axis in image.layout]
    x = np.random.default_rng(0).standard_normal(shape).astype(np.float32).astype(np.float64)
    try:
        in_float64 = float64_forward(forward, image.name, layer)
        exactly = float64_forward(gradient, its_image, GRADIENT)
        found, wanted = in_float64(x), single(x)
        exact = computes_in_double(in_float64, x)
    except Exception:  # the evaluator raises whatever its numpy code does, on ops that it takes otherwise
        return lower
    same = found.shape == wanted.shape and np.abs(found - wanted).max() <= SAME_FORWARD * np.abs(wanted).max()
    return (in_float64, exactly, FLOAT64) if same and exact else lower


def computes_in_double(function: Forward, x: Array64) -> bool:
    """Whether every step of `function` has float64's digits: of the evaluator's ops some go through float32.

    Twice as far along a tiny step it changes twice as much.  Rounding to float32 between would change it by 6e-8 of
    itself at each step, or by nothing.  A kink on the way changes few values, and an op that is constant none.
    """
    v = np.random.default_rng(1).standard_normal(x.shape)
    v *= TINY * (float(x.std()) or 1.0)
    here, near, far = function(x), function(x + v), function(x + 2 * v)
    moved, bent = np.abs(far - here), np.abs(far - 2 * near + here)
    some = moved > 0
    return not some.any() or bool(np.median(bent[some]) <= BENT * np.median(moved[some]))
