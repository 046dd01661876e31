"""Does the gradient agree with central differences?  The check of a model whose framework is not here.

For phi(x) = 1/2 ||F(x)||^2 the derivative along v is, by the graph, <g, v> with g = F^T dF/dx, and by two runs
of the forward pass alone (phi(x + e v) - phi(x - e v)) / 2e.  The forward pass is the file's own, neither
folded nor touched by the adjoint; it runs in float64, by ONNX's reference evaluator, where that agrees with
ONNX Runtime on the model and takes seconds, and in float32 by ONNX Runtime elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import onnx

from elf_runtime.session import open_session

from .cost import node_macs
from .errors import VerificationError
from .float64 import float64_forward
from .foreign.free_sizes import Sizes, with_sizes
from .foreign.image_input import ImageInput
from .graph import Graph
from .preprocessing import Preprocessing
from .reference import preprocess
from .saliency import GRADIENT, IMAGE, SALIENCY

Array = npt.NDArray[np.float32]
Array64 = npt.NDArray[np.float64]
Forward = Callable[[Array64], Array64]

# Two families of directions.  The signs of g, on a random half of the pixels, see a wrong factor or place with
# a signal far above rounding; white noise sees what g lacks, but is nearly orthogonal to any g: in float32
# its derivative drowns.
SIGNS, NOISE = "signs of the gradient", "white noise"
DIRECTIONS = 3  # of each family, on each image


@dataclass(frozen=True)
class Arithmetic:
    """How differences are taken in one precision, and how well they must agree.

    Attributes
    ----------
    steps : e, in standard deviations of the image for v of rms 1
        Rounding errs like 1/e, curvature and switching ReLUs like e: of two neighbouring steps that agree
        best the mean is taken, a choice that does not look at the gradient.
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

AFFORDABLE = 2e9  # multiply-adds of one float64 pass; about half a second
SAME_FORWARD = 1e-4  # of max |F|: the float64 evaluator computes what ONNX Runtime does
# Of max S: the median pixel's difference between the file's S and the mean of float32's |g|.  It is 1e-7 but where
# the graph's own preprocessing, a few ulp from numpy's, switches a ReLU of a deep layer.
SAME_MAP = 5e-3
# Of max |g|, float32's gradient against float64's: the median and 99 % of the pixels.  Where a ReLU switches
# between the two, g differs over its whole receptive field, which for a deep layer is the image.
ROUNDING, SWITCHED = 1e-2, 0.2


@dataclass(frozen=True)
class Direction:
    """One derivative, measured and computed.

    `error` is their difference, as a fraction of the larger of the computed derivative and of what a random
    direction of this length has: ||g|| times the rms of v.
    """

    family: str
    size: str
    measured: float
    computed: float
    error: float


@dataclass(frozen=True)
class Agreement:
    """All directions, and the file against them.

    Attributes
    ----------
    map_error : median |S - mean |g|| / max S, the file's S against the gradient as float32 gives it
    rounding, switched : median and 99th percentile of float32's gradient against float64's, over max |g|
    """

    arithmetic: Arithmetic
    directions: tuple[Direction, ...]
    map_error: float
    rounding: float = 0.0
    switched: float = 0.0

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
        return (
            exact and self.map_error <= SAME_MAP and self.rounding <= ROUNDING and self.switched <= SWITCHED
        )


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
        Over two images of two sizes, one odd where the model takes it.
    """
    differentiate = _in_float32(gradient, GRADIENT, image.name)
    whole, _ = open_session(saliency.SerializeToString())
    evaluate, exactly, arithmetic = _arithmetic(forward, gradient, layer, image, sizes)
    directions: list[Direction] = []
    map_errors: list[float] = []
    roundings: list[tuple[float, float]] = []
    for seed, size in enumerate(dict.fromkeys(sizes.near(*size) for size in arithmetic.sizes)):
        pixels = grainy(*size, preprocessing.channels, seed)[None]
        x = preprocess(pixels, preprocessing, layout=image.layout).astype(np.float32).astype(np.float64)
        g, g_exact = differentiate(x), exactly(x)
        if not g.any():
            raise VerificationError(f"{layer!r} has no gradient on a natural image: it is zero everywhere")
        found = whole.run([SALIENCY], {IMAGE: pixels})[0]
        wanted = np.abs(g).mean(axis=image.layout.index("C"))
        map_errors.append(float(np.median(np.abs(found - wanted)) / wanted.max()))
        low, high = np.percentile(np.abs(g - g_exact) / np.abs(g_exact).max(), (50, 99))
        roundings.append((float(low), float(high)))
        directions += _along(evaluate, x, g_exact, f"{size[1]}x{size[0]}", arithmetic, seed)
    rounding, switched = (max(values) for values in zip(*roundings, strict=True))
    return Agreement(arithmetic, tuple(directions), max(map_errors), rounding, switched)


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
    lower = in_float32, _in_float32(gradient, GRADIENT, image.name), FLOAT32
    height, width = sizes.near(*FLOAT64.sizes[0])
    static = Graph(with_sizes(forward, image, Sizes(height, width, 1)))
    if sum(node_macs(static, node) for node in static.nodes) > AFFORDABLE:
        return lower
    shape = [{"N": 1, "C": image.channels, "H": height, "W": width}[axis] for axis in image.layout]
    x = np.random.default_rng(0).standard_normal(shape).astype(np.float32).astype(np.float64)
    try:
        in_float64 = float64_forward(forward, image.name, layer)
        exactly = float64_forward(gradient, image.name, GRADIENT)
        exactly(x)
        found, wanted = in_float64(x), in_float32(x)
    except Exception:  # the evaluator raises whatever its numpy code does, on ops that it takes otherwise
        return lower
    same = found.shape == wanted.shape and np.abs(found - wanted).max() <= SAME_FORWARD * np.abs(wanted).max()
    return (in_float64, exactly, FLOAT64) if same else lower


def _along(
    forward: Forward, x: Array64, g: Array64, size: str, arithmetic: Arithmetic, seed: int
) -> list[Direction]:
    rng = np.random.default_rng(seed)
    spread = float(x.std()) or 1.0
    norm = float(np.sqrt((g * g).sum()))
    result = []
    for family in arithmetic.families:
        for _ in range(DIRECTIONS):
            v = _direction(family, g, rng)
            v *= spread / np.sqrt((v * v).mean())
            measured = _derivative(forward, x, v, arithmetic)
            computed = float((g * v).sum())
            error = abs(measured - computed) / max(abs(computed), norm * spread)
            result.append(Direction(family, size, measured, computed, error))
    return result


def _direction(family: str, g: Array64, rng: np.random.Generator) -> Array64:
    if family == NOISE:
        return rng.standard_normal(g.shape)
    signs = np.where(g != 0, np.sign(g), rng.choice([-1.0, 1.0], g.shape))
    return np.asarray(signs * (rng.random(g.shape) < 0.5), np.float64)


def _derivative(forward: Forward, x: Array64, v: Array64, arithmetic: Arithmetic) -> float:
    """The derivative of phi along `v`, at the two neighbouring steps that agree best."""
    found = [_difference(forward, x, v, step) for step in arithmetic.steps]
    best = int(np.argmin(np.abs(np.diff(found))))
    return (found[best] + found[best + 1]) / 2


def _difference(forward: Forward, x: Array64, v: Array64, step: float) -> float:
    ahead, behind = (x + sign * step * v for sign in (1, -1))
    f_ahead, f_behind = forward(ahead), forward(behind)
    # (a^2 - b^2) / 2 = (a - b) (a + b) / 2 keeps the digits that two large sums would lose.
    return float(((f_ahead - f_behind) * (f_ahead + f_behind)).sum()) / (4 * step)


def grainy(height: int, width: int, channels: int, seed: int) -> Array:
    """A picture without ties: (H, W, C) float32 in 0..255, waves and edges under a fine grain.

    Where two pixels of a pooling window are equal the derivative does not exist, and no two steps would agree.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    picture = np.zeros((height, width, channels))
    for _ in range(12):
        fy, fx, phase = rng.normal(0, 0.25), rng.normal(0, 0.25), rng.uniform(0, 2 * np.pi)
        wave = np.sin(fy * y + fx * x + phase)
        picture += (np.sign(wave) if rng.random() < 0.5 else wave)[..., None] * rng.uniform(0.2, 1, channels)
    picture += 0.3 * rng.standard_normal(picture.shape)
    low, high = picture.min(), picture.max()
    return np.asarray(255 * (picture - low) / (high - low), np.float32)


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
        f"{d.family:<44}{d.size:>9}{d.measured:>14.6g}{d.computed:>14.6g}{d.error:>9.1e}"
        for d in agreement.directions
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
