"""Does the gradient agree with central differences?  The check of a model whose framework is not here.

For phi(x) = 1/2 ||F(x)||^2 the derivative along v is, by the graph, <g, v> with g = F^T dF/dx, and by two runs
of the forward pass alone (phi(x + e v) - phi(x - e v)) / 2e.  The forward pass is the file's own, neither
folded nor touched by the adjoint.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import onnx

from elf_runtime.session import open_session

from .errors import VerificationError
from .foreign.free_sizes import Sizes
from .foreign.image_input import ImageInput
from .preprocessing import Preprocessing
from .reference import preprocess
from .saliency import GRADIENT, SALIENCY

Array = npt.NDArray[np.float32]
Forward = Callable[[Array], Array]

# Two families of directions.  White noise sees a component that the gradient lacks; the gradient itself, on a
# patch of the image, sees a wrong factor or a wrong place, with a signal far above float32's rounding.
NOISE, PATCH = "white noise", "gradient on a patch"
DIRECTIONS = 4  # of each family, on each image
# e v, in standard deviations of the image.  Rounding errs like 1/e, curvature and switching ReLUs like e: of
# these steps the one is taken where two neighbours agree best, which does not look at the gradient.
STEPS = (1e-3, 3e-3, 1e-2, 3e-2)

TYPICAL = 5e-3  # the median error over all directions stays below this
LARGEST = 5e-2  # and each below this
SAME_MAP = 1e-4  # of max S: the median pixel's difference between the file's S and the mean of |g|


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
    """All directions, and the file's saliency against the gradient's."""

    directions: tuple[Direction, ...]
    map_error: float

    @property
    def typical(self) -> float:
        return float(np.median([d.error for d in self.directions]))

    @property
    def largest(self) -> float:
        return max(d.error for d in self.directions)

    @property
    def passed(self) -> bool:
        return self.typical <= TYPICAL and self.largest <= LARGEST and self.map_error <= SAME_MAP


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
    run, _ = open_session(forward.SerializeToString())
    differentiate, _ = open_session(gradient.SerializeToString())
    whole, _ = open_session(saliency.SerializeToString())
    directions: list[Direction] = []
    map_errors = []
    for seed, (height, width) in enumerate(dict.fromkeys((sizes.near(96, 128), sizes.near(101, 141)))):
        pixels = grainy(height, width, preprocessing.channels, seed)[None]
        x = preprocess(pixels, preprocessing, image.layout).astype(np.float32)
        g = differentiate.run([GRADIENT], {image.name: x})[0]
        found = whole.run([SALIENCY], {"image": pixels})[0]
        wanted = np.abs(g.astype(np.float64)).mean(axis=image.layout.index("C"))
        top = max(float(wanted.max()), np.finfo(np.float32).tiny)
        map_errors.append(float(np.median(np.abs(found - wanted))) / top)
        directions += _along(
            lambda x: run.run([layer], {image.name: x})[0], x, g, f"{width}x{height}", image.layout, seed
        )  # fmt: skip
    return Agreement(tuple(directions), max(map_errors))


def _along(forward: Forward, x: Array, g: Array, size: str, layout: str, seed: int) -> list[Direction]:
    rng = np.random.default_rng(seed)
    spread = float(x.std()) or 1.0
    g64 = g.astype(np.float64)
    norm = float(np.sqrt((g64 * g64).sum()))
    vectors = [(NOISE, rng.standard_normal(x.shape)) for _ in range(DIRECTIONS)]
    vectors += [(PATCH, g64 * _patch(x.shape, layout, rng)) for _ in range(DIRECTIONS)]
    result = []
    for family, v in vectors:
        rms = float(np.sqrt((v * v).mean()))
        if rms == 0.0:  # a patch that the layer does not see
            continue
        v = v * (spread / rms)
        measured = _derivative(forward, x, v)
        computed = float((g64 * v).sum())
        scale = max(abs(computed), norm * spread, np.finfo(np.float32).tiny)
        result.append(Direction(family, size, measured, computed, abs(measured - computed) / scale))
    return result


def _derivative(forward: Forward, x: Array, v: npt.NDArray[np.float64]) -> float:
    """The derivative of phi along `v`, at the step where two neighbouring steps agree best."""
    found = [_difference(forward, x, v, step) for step in STEPS]
    gaps = [abs(a - b) for a, b in zip(found, found[1:], strict=False)]
    best = int(np.argmin(gaps))
    return (found[best] + found[best + 1]) / 2


def _difference(forward: Forward, x: Array, v: npt.NDArray[np.float64], step: float) -> float:
    ahead, behind = ((x + sign * step * v).astype(np.float32) for sign in (1, -1))
    f_ahead, f_behind = (forward(point).astype(np.float64) for point in (ahead, behind))
    # (a^2 - b^2) / 2 = (a - b) (a + b) / 2 keeps the digits that two large sums would lose.
    return float(((f_ahead - f_behind) * (f_ahead + f_behind)).sum()) / (4 * step)


def _patch(shape: Sequence[int], layout: str, rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """1 on a rectangle of about a quarter of the image, 0 elsewhere; over all channels."""
    mask = np.zeros(shape)
    inside = [slice(None)] * len(shape)
    for axis in "HW":
        size = shape[layout.index(axis)]
        start = int(rng.integers(0, size // 2 + 1))
        inside[layout.index(axis)] = slice(start, start + max(size // 2, 1))
    mask[tuple(inside)] = 1.0
    return mask


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
    return (255 * (picture - low) / (high - low)).astype(np.float32)


def require(agreement: Agreement) -> None:
    """Raise VerificationError unless the agreement `passed`."""
    if not agreement.passed:
        raise VerificationError(
            f"the graph's gradient disagrees with central differences of 1/2 ||F||^2:\n{table(agreement)}\nWanted "
            f"are a median error of at most {TYPICAL:g}, each at most {LARGEST:g}, and S within {SAME_MAP:g} of the "
            "gradient's. No file was written."
        )


def table(agreement: Agreement) -> str:
    """The directions as a small text table."""
    rows = [f"{'derivative of 1/2 |F|^2 along':<32}{'size':>10}{'differences':>14}{'the graph':>14}{'error':>10}"]
    rows += [
        f"{d.family:<32}{d.size:>10}{d.measured:>14.6g}{d.computed:>14.6g}{d.error:>10.1e}"
        for d in agreement.directions
    ]
    rows.append(
        f"median error {agreement.typical:.1e}, largest {agreement.largest:.1e}; S against mean |gradient| "
        f"{agreement.map_error:.1e} of max S"
    )
    return "\n".join(rows)


def parity(agreement: Agreement) -> dict[str, float]:
    """The figures for the contract."""
    return {
        "derivative_median_error": agreement.typical,
        "derivative_max_error": agreement.largest,
        "saliency_median_error": agreement.map_error,
    }
