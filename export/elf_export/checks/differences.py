"""Does the gradient agree with central differences?  The check of a model whose framework is not here.

For phi(x) = 1/2 ||F(x)||^2 the derivative along v is, by the graph, <g, v> with g = F^T dF/dx, and by two runs
of the forward pass alone (phi(x + e v) - phi(x - e v)) / 2e.  The forward pass is the file's own, neither
folded nor touched by the adjoint; it runs in float64, by ONNX's reference evaluator, where that agrees with
ONNX Runtime on the model and takes seconds, and in float32 by ONNX Runtime elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import onnx

from elf_export.errors import VerificationError
from elf_export.graph.cost import macs
from elf_export.graph.graph import GraphView
from elf_export.preprocessing import Preprocessing
from elf_export.saliency import GRADIENT, IMAGE, SALIENCY
from elf_export.sources.foreign.free_sizes import Sizes, with_sizes
from elf_export.sources.foreign.image_input import ImageInput
from elf_runtime.model.session import open_session

from .directional import FLOAT32, FLOAT64, Arithmetic, Array, Array64, Direction, Forward, along, grainy
from .float64 import float64_forward
from .reference import preprocess

AFFORDABLE = 2e9  # multiply-adds of one float64 pass; about half a second
SAME_FORWARD = 1e-4  # of max |F|: the float64 evaluator computes what ONNX Runtime does
# Of max S: the median pixel's difference between the file's S and the mean of float32's |g|.  It is 1e-7 but where
# the graph's own preprocessing, a few ulp from numpy's, switches a ReLU of a deep layer.
SAME_MAP = 5e-3
# Of max |g|, float32's gradient against float64's: the median and 99 % of the pixels.  Where a ReLU switches
# between the two, g differs over its whole receptive field, which for a deep layer is the image.
ROUNDING, SWITCHED = 1e-2, 0.2
PICTURES = 3  # of each size, the next where one does not agree: a wrong gradient agrees on none
TINY = 1e-8  # of the image's standard deviation: a step that float32 would drown
BENT = 1e-2  # of a change over two such steps: what it may differ from twice the first by
CONSTANT, HARDLY = 1e-9, 1e-3  # of ||F||^2, see `require_dependence`


@dataclass(frozen=True)
class Agreement:
    """All directions, and the file against them.

    Attributes
    ----------
    map_error : median |S - mean |g|| / max S, the file's S against the gradient as float32 gives it
    rounding, switched : median and 99th percentile of float32's gradient against float64's, over max |g|
    dependence : what a standard deviation of the image changes ||F||^2 by, of itself, as `require_dependence` says
    """

    arithmetic: Arithmetic
    directions: tuple[Direction, ...]
    map_error: float
    rounding: float = 0.0
    switched: float = 0.0
    dependence: float = np.inf

    @property
    def typical(self) -> float:
        return float(np.median([d.error for d in self.directions]))

    @property
    def largest(self) -> float:
        return max(d.error for d in self.directions)

    @property
    def passed(self) -> bool:
        wanted = self.arithmetic
        exact = self.typical <= wanted.typical and self.largest <= wanted.largest
        return exact and self.map_error <= SAME_MAP and self.rounding <= ROUNDING and self.switched <= SWITCHED


def check(
    forward: onnx.ModelProto,
    gradient: onnx.ModelProto,
    saliency: onnx.ModelProto,
    layer: str,
    image: ImageInput,
    sizes: Sizes,
    preprocessing: Preprocessing,
) -> Agreement:
    """Compare the gradient with differences of `forward`, and the saliency map with the gradient.

    Parameters
    ----------
    forward : onnx.ModelProto
        The user's model, cut at `layer`.
    gradient, saliency : onnx.ModelProto
        As `build_gradient` and `build_saliency` made them.

    Returns
    -------
    Agreement
        Over two images of two sizes, one odd where the model takes it.  Two values of a pooling window that happen to
        be equal to eight digits make a picture where differences and any gradient disagree: then another is taken.

    Raises
    ------
    VerificationError
        If the layer or its gradient is not finite there, or beside the images; if it has no gradient, or one of
        rounding only, as `require_dependence`.
    """
    differentiate = _in_float32(gradient, GRADIENT, gradient.graph.input[0].name)
    whole, _ = open_session(saliency.SerializeToString())
    evaluate, exactly, arithmetic = _arithmetic(forward, gradient, layer, image, sizes)

    def on_picture(size: tuple[int, int], seed: int) -> Agreement:
        pixels = grainy(*size, preprocessing.channels, seed)[None]
        x = preprocess(pixels, preprocessing, layout=image.layout).astype(np.float32).astype(np.float64)
        f, g, g_exact = evaluate(x), differentiate(x), exactly(x)
        require_finite(layer, f, g, g_exact)
        if not g.any():
            raise VerificationError(f"{layer!r} has no gradient on a natural image: it is zero everywhere")
        dependence = require_dependence(layer, f, g_exact, x)
        found = whole.run([SALIENCY], {IMAGE: pixels})[0]
        wanted = np.abs(g).mean(axis=image.layout.index("C"))
        map_error = float(np.median(np.abs(found - wanted)) / wanted.max())
        rounding, switched = np.percentile(np.abs(g - g_exact) / np.abs(g_exact).max(), (50, 99))
        directions = along(evaluate, x, f, g_exact, f"{size[1]}x{size[0]}", arithmetic, seed)
        if not np.isfinite([d.measured for d in directions]).all():
            raise VerificationError(
                f"{layer!r} is NaN or infinite close to a natural image, so that its gradient can't be checked; "
                "choose another layer, or other preprocessing"
            )
        return Agreement(arithmetic, tuple(directions), map_error, float(rounding), float(switched), dependence)

    parts = []
    for first, size in enumerate(dict.fromkeys(sizes.near(*size) for size in arithmetic.sizes)):
        for picture in range(PICTURES):
            part = on_picture(size, first + 10 * picture)
            if part.passed:
                break
        parts.append(part)
    return Agreement(
        arithmetic,
        tuple(direction for part in parts for direction in part.directions),
        max(part.map_error for part in parts),
        max(part.rounding for part in parts),
        max(part.switched for part in parts),
        min(part.dependence for part in parts),
    )


def require_finite(layer: str, f: Array64, *gradients: Array64) -> None:
    """Raise VerificationError where F or its gradient is NaN or infinite."""
    for what, values in ((repr(layer), [f]), (f"the gradient of {layer!r}", gradients)):
        if not all(np.isfinite(value).all() for value in values):
            raise VerificationError(
                f"{what} is NaN or infinite on a natural image; choose another layer, or other preprocessing"
            )


def require_dependence(layer: str, f: Array64, g: Array64, x: Array64) -> float:
    """How much 1/2 ||F||^2 depends on the image; raises VerificationError where it does by rounding only.

    Every value of the image is moved by a standard deviation of the image, to the side that raises 1/2 ||F||^2; by
    its derivative this adds sum |g| std(x), of which the share of ||F||^2 is returned.  For a network of convolutions
    and ReLUs without biases it is about once ||F||^2 or more; layers of networks give 0.1 to 50 times.  Below HARDLY
    lies what a LayerNorm or an InstanceNorm leaves, by its epsilon (2e-4), but also a layer whose constant outweighs
    the image: their gradient is one that differences can check, if they have digits enough.  An L2 normalisation
    leaves float64's rounding, 4e-16, which CONSTANT lies well above.

    Parameters
    ----------
    f, g, x : F, the gradient of 1/2 ||F||^2, and the image
    """
    change = float(np.abs(g).sum() * x.std() / (f * f).sum())
    if change < CONSTANT:
        raise VerificationError(
            f"{layer!r} can't give keypoints: it is normalised, so that ||F||^2 hardly depends on the image (a "
            f"standard deviation of the image changes it by {change:.1g} of itself); take the layer before the "
            "normalisation"
        )
    return change


def _in_float32(model: onnx.ModelProto, output: str, image: str) -> Forward:
    session, _ = open_session(model.SerializeToString())

    def run(x: Array64) -> Array64:
        value: Array = session.run([output], {image: x.astype(np.float32)})[0]
        return value.astype(np.float64)

    return run


def _arithmetic(
    forward: onnx.ModelProto, gradient: onnx.ModelProto, layer: str, image: ImageInput, sizes: Sizes
) -> tuple[Forward, Forward, Arithmetic]:
    """The forward pass and the gradient, in the best arithmetic that can be had for this model."""
    in_float32 = _in_float32(forward, layer, image.name)
    its_image = gradient.graph.input[0].name
    lower = in_float32, _in_float32(gradient, GRADIENT, its_image), FLOAT32
    height, width = sizes.near(*FLOAT64.sizes[0])
    static = GraphView(with_sizes(forward, image, Sizes(height, width, 1)))
    if sum(macs(static)) > AFFORDABLE:
        return lower
    shape = [{"N": 1, "C": image.channels, "H": height, "W": width}[axis] for axis in image.layout]
    x = np.random.default_rng(0).standard_normal(shape).astype(np.float32).astype(np.float64)
    try:
        in_float64 = float64_forward(forward, image.name, layer)
        exactly = float64_forward(gradient, its_image, GRADIENT)
        found, wanted = in_float64(x), in_float32(x)
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


def require(agreement: Agreement) -> None:
    """Raise VerificationError unless the agreement `passed`."""
    if not agreement.passed:
        wanted = agreement.arithmetic
        raise VerificationError(
            f"the graph's gradient disagrees with central differences of 1/2 ||F||^2:\n{table(agreement)}\nWanted "
            f"are a median error of at most {wanted.typical:g}, each at most {wanted.largest:g}, and S within "
            f"{SAME_MAP:g} of the gradient's; float32's rounding may be {ROUNDING:g}, {SWITCHED:g} at 99 % of the "
            "pixels. No file was written."
        )


def table(agreement: Agreement) -> str:
    """The directions as a small text table."""
    title = f"derivative of 1/2 |F|^2 in {agreement.arithmetic.name}, along"
    rows = [f"{title:<44}{'image':>9}{'differences':>14}{'the graph':>14}{'error':>9}"]
    rows += [
        f"{d.family:<44}{d.size:>9}{d.measured:>14.6g}{d.computed:>14.6g}{d.error:>9.1e}" for d in agreement.directions
    ]
    rows.append(
        f"median error {agreement.typical:.1e}, largest {agreement.largest:.1e}; S against mean |gradient| "
        f"{agreement.map_error:.1e} of max S"
    )
    if agreement.arithmetic is FLOAT64:
        rows.append(
            f"float32's gradient against float64's: median {agreement.rounding:.1e} of max |g|, 99 % within "
            f"{agreement.switched:.1e}"
        )
    if agreement.dependence < HARDLY:
        rows.append(
            f"||F||^2 hardly depends on the image (a standard deviation changes it by {agreement.dependence:.1g} of "
            "itself): the layer is normalised, take the one before, or a constant outweighs it"
        )
    return "\n".join(rows)


def parity(agreement: Agreement) -> dict[str, float]:
    """The figures for the contract."""
    return {
        "derivative_median_error": agreement.typical,
        "derivative_max_error": agreement.largest,
        "saliency_median_error": agreement.map_error,
        "float32_median_error": agreement.rounding,
        "float32_error_of_99_percent": agreement.switched,
    }
