"""Does the gradient agree with central differences?  The check of a model whose framework is not here.

For phi(x) = 1/2 ||F(x)||^2 the derivative along v is, by the graph, <g, v> with g = F^T dF/dx, and by two runs
of the forward pass alone (phi(x + e v) - phi(x - e v)) / 2e.  The forward pass is the file's own, neither
folded nor touched by the adjoint; it runs in float64, by ONNX's reference evaluator, where that agrees with
ONNX Runtime on the model and takes seconds, and in float32 by ONNX Runtime elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import onnx

from elf_export.errors import VerificationError
from elf_export.graph.image_input import ImageInput
from elf_export.graph.passes import cut
from elf_export.graph.sizes import Sizes
from elf_export.preprocessing import Preprocessing
from elf_export.saliency import GRADIENT, IMAGE, SALIENCY, build_gradient, descriptor_output
from elf_runtime import DetectionParams
from elf_runtime.model.session import open_session

from .arithmetic import FLOAT64, Arithmetic, Array64, best_arithmetic, in_float32
from .directional import Direction, along
from .pictures import Array, grainy, preprocess

# Of max S: the median pixel's difference between the file's S and the mean of float32's |g|.  It is 1e-7 but where
# the graph's own preprocessing, a few ulp from numpy's, switches a ReLU of a deep layer.
SAME_MAP = 5e-3
# Of max |g|, float32's gradient against float64's: the median and 99 % of the pixels.  Where a ReLU switches
# between the two, g differs over its whole receptive field, which for a deep layer is the image.
ROUNDING, SWITCHED = 1e-2, 0.2
PICTURES = 3  # of each size, the next where one does not agree: a wrong gradient agrees on none
CONSTANT, HARDLY = 1e-9, 1e-3  # of ||F||^2, see `require_dependence`


@dataclass(frozen=True)
class DifferencesCheck:
    """The gradient along all directions, and the file's saliency map against the gradient.

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

    @property
    def complaint(self) -> str:
        wanted = self.arithmetic
        return (
            "the graph's gradient disagrees with central differences of 1/2 ||F||^2. Wanted are a median error of at "
            f"most {wanted.typical:g}, each at most {wanted.largest:g}, and S within {SAME_MAP:g} of the gradient's; "
            f"float32's rounding may be {ROUNDING:g}, {SWITCHED:g} at 99 % of the pixels."
        )

    def table(self) -> str:
        title = f"derivative of 1/2 |F|^2 in {self.arithmetic.name}, along"
        rows = [f"{title:<44}{'image':>9}{'differences':>14}{'the graph':>14}{'error':>9}"]
        rows += [
            f"{d.family:<44}{d.size:>9}{d.measured:>14.6g}{d.computed:>14.6g}{d.error:>9.1e}" for d in self.directions
        ]
        rows.append(
            f"median error {self.typical:.1e}, largest {self.largest:.1e}; S against mean |gradient| "
            f"{self.map_error:.1e} of max S"
        )
        if self.arithmetic is FLOAT64:
            rows.append(
                f"float32's gradient against float64's: median {self.rounding:.1e} of max |g|, 99 % within "
                f"{self.switched:.1e}"
            )
        if self.dependence < HARDLY:
            rows.append(
                f"||F||^2 hardly depends on the image (a standard deviation changes it by {self.dependence:.1g} of "
                "itself): the layer is normalised, take the one before, or a constant outweighs it"
            )
        return "\n".join(rows)

    def figures(self) -> dict[str, float]:
        return {
            "derivative_median_error": self.typical,
            "derivative_max_error": self.largest,
            "saliency_median_error": self.map_error,
            "float32_median_error": self.rounding,
            "float32_error_of_99_percent": self.switched,
        }


@dataclass(frozen=True)
class Differences:
    """The oracle of a network that is a graph and nothing else.

    Attributes
    ----------
    forward : onnx.ModelProto
        The user's network, neither folded nor touched by the adjoint.
    layer : str
        F.
    """

    forward: onnx.ModelProto
    layer: str
    image: ImageInput
    preprocessing: Preprocessing

    def check(self, model: onnx.ModelProto, color: str, params: DetectionParams, sizes: Sizes) -> DifferencesCheck:
        """Compare the gradient with differences of the forward pass, and the map of a saliency graph with the gradient.

        Over two pictures of two sizes, one odd where the model takes it.  Two values of a pooling window that happen to
        be equal to eight digits make a picture where differences and any gradient disagree: then another is taken.

        Parameters
        ----------
        model : onnx.ModelProto
            As `build_saliency` makes it, its image of colour order `color`.
        sizes : Sizes
            That the model takes.

        Raises
        ------
        VerificationError
            If the layer or its gradient is not finite there, or beside the images; if it has no gradient, or one of
            rounding only, as `require_dependence`.
        """
        del params
        forward, layer = cut(self.forward, [self.layer]), self.layer
        gradient = build_gradient(self.forward, layer, self.image.name)
        differentiate = in_float32(gradient, GRADIENT, gradient.graph.input[0].name)
        whole, _ = open_session(model.SerializeToString())
        evaluate, exactly, arithmetic = best_arithmetic(forward, gradient, layer, self.image, sizes)
        channels = 1 if color == "gray" else 3

        def on_picture(size: tuple[int, int], seed: int) -> DifferencesCheck:
            pixels = grainy(*size, channels, seed)[None]
            x = preprocess(pixels, self.preprocessing, color, self.image.layout)
            x = x.astype(np.float32).astype(np.float64)
            f, g, g_exact = evaluate(x), differentiate(x), exactly(x)
            require_finite(layer, f, g, g_exact)
            if not g.any():
                raise VerificationError(f"{layer!r} has no gradient on a natural image: it is zero everywhere")
            dependence = require_dependence(layer, f, g_exact, x)
            found = whole.run([SALIENCY], {IMAGE: pixels})[0]
            wanted = np.abs(g).mean(axis=self.image.layout.index("C"))
            map_error = float(np.median(np.abs(found - wanted)) / wanted.max())
            rounding, switched = np.percentile(np.abs(g - g_exact) / np.abs(g_exact).max(), (50, 99))
            directions = along(evaluate, x, f, g_exact, f"{size[1]}x{size[0]}", arithmetic, seed)
            if not np.isfinite([d.measured for d in directions]).all():
                raise VerificationError(
                    f"{layer!r} is NaN or infinite close to a natural image, so that its gradient can't be checked; "
                    "choose another layer, or other preprocessing"
                )
            return DifferencesCheck(
                arithmetic, tuple(directions), map_error, float(rounding), float(switched), dependence
            )

        parts = []
        for first, size in enumerate(dict.fromkeys(sizes.near(*size) for size in arithmetic.sizes)):
            for picture in range(PICTURES):
                part = on_picture(size, first + 10 * picture)
                if part.passed:
                    break
            parts.append(part)
        return DifferencesCheck(
            arithmetic,
            tuple(direction for part in parts for direction in part.directions),
            max(part.map_error for part in parts),
            max(part.rounding for part in parts),
            max(part.switched for part in parts),
            min(part.dependence for part in parts),
        )

    def maps(self, model: onnx.ModelProto, layers: Sequence[str], _: str) -> Callable[[Array], Mapping[str, Array]]:
        """The descriptor maps of a saliency graph itself, as they are before a projection is put into it."""
        if not layers:  # ONNX Runtime takes an empty list for all outputs
            return lambda _: {}
        session, _options = open_session(model.SerializeToString())
        outputs = [descriptor_output(layer) for layer in layers]

        def of_layers(pixels: Array) -> dict[str, Array]:
            return dict(zip(layers, session.run(outputs, {IMAGE: pixels}), strict=True))

        return of_layers

    def averaging(self, forward: onnx.ModelProto) -> Differences:
        return replace(self, forward=forward)

    def describing(self, forward: onnx.ModelProto, image: ImageInput) -> Differences:
        return replace(self, forward=forward, image=image)


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
