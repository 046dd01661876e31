"""Which image sizes a network takes: freeing those that its file fixes without need."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime as ort

from elf_export.errors import ExportError
from elf_export.graph.image_input import ImageInput
from elf_export.graph.sizes import Sizes, with_sizes
from elf_runtime.errors import first_line

from .affordable import require_affordable

# Of free heights and widths, tried from the left; where the last of a row does not suit, none of it does.  The rows are
# strides of powers of two, and the same under windows of 7, 12 and 10 cells or patches of 14 pixels.
MULTIPLES = (
    (1, 2, 4, 8, 16, 32, 64),
    (7, 14, 28, 56, 112, 224),
    (3, 6, 12, 24, 48, 96, 192),
    (5, 10, 20, 40, 80, 160),
)
LEAST = (32, 48, 64, 96, 128, 160, 224)
PROBE = (96, 128)  # about so many pixels of height and width
LONG = 2048  # pixels
RUN = (8, 64)  # fewest and most sizes in a row that are tried
SAME = 1e-3  # of the largest value: what two kernels of one network may differ by in float32

Map = npt.NDArray[np.float32]


def free_sizes(model: onnx.ModelProto, image: ImageInput, stride: float = 1.0) -> tuple[onnx.ModelProto, Sizes]:
    """`model` with as few fixed sizes as it runs with.

    A file often fixes the size that it was exported with although no node depends on it.  All three are
    tried free, then the batch and the image each alone, by running: a graph of symbols would prove nothing,
    as a Reshape to constants is valid ONNX for any size.  At the file's own size the result must stay the
    same, and a batch must give what its images give one by one.

    Parameters
    ----------
    stride : float
        The largest of the model's layers, in pixels: the sizes that it takes repeat themselves after it.

    Returns
    -------
    (model, sizes)
        The model's stale shapes are dropped, those of free axes are symbols.

    Raises
    ------
    ExportError
        If the model doesn't run at all, needs too much memory, or runs only on batches of several images.
    """
    batch, height, width = image.size
    require_affordable(with_sizes(model, image, Sizes(height or PROBE[0], width or PROBE[1], batch or 1)), image)
    attempts = [
        Sizes(),
        Sizes(batch=batch or 0),
        Sizes(height=height or 0),
        Sizes(height or 0, width or 0),
        Sizes(height or 0, width or 0, batch or 0),
    ]
    tried, reason = set(), ""
    try:
        own = Runner(model, image).outputs_at(image.size) if height and width else []
    except Exception as error:  # onnxruntime's own exceptions share no base of theirs
        raise ExportError(f"onnxruntime {ort.__version__} can't run the model: {first_line(error)}") from error
    expected = own if own and batch else None
    by_image = [value.ndim > 0 and len(value) == (batch or 1) for value in own]
    for attempt in attempts:
        if attempt in tried:
            continue
        tried.add(attempt)
        freed = with_sizes(model, image, attempt)
        try:
            found = _works(Runner(freed, image, by_image), attempt, image, expected, stride)
        except Exception as error:  # onnxruntime's own exceptions share no base of theirs
            reason = first_line(error)
            continue
        if isinstance(found, Sizes):
            if found.batch > 1:
                raise ExportError(
                    f"the model takes batches of {found.batch} images and no others; export it again with a free "
                    "batch size, or with one of 1"
                )
            return freed, found
        reason = found
    raise ExportError(f"onnxruntime {ort.__version__} runs the model at no size that was tried: {reason}")


class Runner:
    """Runs a model on noise.

    Attributes
    ----------
    by_image : bool for each output, or none
        Whether the first axis counts the images at the file's own size: then it must at every other.  A Reshape to
        (-1, ...) takes cells for images there.
    """

    def __init__(self, model: onnx.ModelProto, image: ImageInput, by_image: Sequence[bool] = ()) -> None:
        options = ort.SessionOptions()
        options.log_severity_level = 4
        self.session = ort.InferenceSession(model.SerializeToString(), options, ["CPUExecutionProvider"])
        self.image, self.by_image = image, by_image

    def outputs(self, pixels: Map) -> list[Map]:
        values: list[Map] = self.session.run(None, {self.image.name: pixels})
        if any(own and len(map_) != len(pixels) for own, map_ in zip(self.by_image, values, strict=False)):
            raise ValueError("it takes parts of an image for images of their own")
        return values

    def outputs_at(self, size: Sequence[int | None]) -> list[Map]:
        return self.outputs(self.noise(*(int(v or 1) for v in size)))

    def noise(self, batch: int, height: int, width: int) -> Map:
        axes = {"N": batch, "C": self.image.channels, "H": height, "W": width}
        values = np.random.default_rng(0).standard_normal([axes[a] for a in self.image.layout])
        return values.astype(np.float32)


def _works(runner: Runner, sizes: Sizes, image: ImageInput, expected: list[Map] | None, stride: float) -> Sizes | str:
    """`sizes` with the multiple and the smallest size that the model needs, why not if it takes none of them."""
    if expected is not None and (
        reason := unlike(runner.outputs_at(image.size), expected, "the file as it stands gives")
    ):
        return reason
    reason = ""
    for row in MULTIPLES:
        for multiple in row:
            why_not = _fails(runner, sizes, _probe(multiple))
            found = why_not or first_that_holds(runner, replace(sizes, multiple=multiple), stride)
            if isinstance(found, Sizes):
                return found
            if multiple == row[0] and (last := _fails(runner, sizes, _probe(row[-1]))):
                reason = reason or last
                break
            reason = reason or found
    return reason


def first_that_holds(runner: Runner, sizes: Sizes, stride: float) -> Sizes | str:
    """`sizes` from the smallest size on from which the model runs on every multiple; why not, if from none."""
    reason = ""
    for least in dict.fromkeys(-(-size // sizes.multiple) * sizes.multiple for size in LEAST):
        if least >= sizes.min_size:
            breaks = _breaks_at(runner, replace(sizes, min_size=least), stride)
            if not breaks:
                return replace(sizes, min_size=least)
            reason = reason or breaks
            if sizes.height and sizes.width:
                break
    return reason


def _breaks_at(runner: Runner, sizes: Sizes, stride: float) -> str:
    """Why some image of at least ``sizes.min_size`` breaks the model, empty if none does.

    A pool rounds a size down and a window wants whole cells, by the size modulo the network's stride: all the multiples
    in one such period are tried as heights and, in the other order, as widths, some of twice the size, and images as
    high and as wide as photographs, but narrow: a table of positions ends somewhere.  Of a long period some are tried,
    all over it.
    """
    if sizes.height and sizes.width:
        return _stops(runner, sizes, sizes.height, sizes.width)
    step, least = sizes.multiple, sizes.min_size
    period = math.ceil(stride) // math.gcd(math.ceil(stride), step)
    count = min(max(period, RUN[0]), RUN[1])
    apart = -(-period // count) * step
    run = [least + i * apart for i in range(count)]
    far = [-(-2 * least // step) * step + i * step for i in (0, 1, 3)]
    long = LONG // step * step
    shapes = [*zip(run[::-1], run, strict=True), *zip(far, far[::-1], strict=True), (long, least), (least, long)]
    for height, width in shapes:
        reason = _stops(runner, sizes, sizes.height or height, sizes.width or width)
        if reason:
            return f"{reason} (at {width}x{height} pixels)"
    return ""


def _stops(runner: Runner, sizes: Sizes, height: int, width: int) -> str:
    """Why the model does not run on an image of this size; empty if it does."""
    try:
        maps = runner.outputs_at((sizes.batch or 1, height, width))
    except Exception as error:  # onnxruntime's own exceptions share no base of theirs
        return first_line(error)
    return "" if all(value.size for value in maps) else "its maps are empty"


def _probe(multiple: int) -> tuple[int, int]:
    """About PROBE pixels: an odd and an even multiple, as rounding differs between the two."""
    h, w = (max(round(v / multiple), 1) for v in PROBE)
    return (h | 1) * multiple, (w + w % 2) * multiple


def _fails(runner: Runner, sizes: Sizes, size: tuple[int, int]) -> str:
    """Why the model does not take images of a size, or not two at once; empty if it does."""
    height, width = sizes.height or size[0], sizes.width or size[1]
    try:
        if sizes.batch:
            runner.outputs_at((sizes.batch, height, width))
            return ""
        pair = runner.noise(2, height, width)
        together = runner.outputs(pair)
        apart = [runner.outputs(pair[i : i + 1]) for i in range(2)]
    except Exception as error:  # onnxruntime's own exceptions share no base of theirs
        return first_line(error)
    return unlike(
        together, [np.concatenate(maps) for maps in zip(*apart, strict=True)], "each of its images alone gives"
    )


def unlike(found: list[Map], wanted: list[Map], other: str) -> str:
    """How results differ from wanted ones, those of `other`; empty if they don't."""
    for a, b in zip(found, wanted, strict=True):
        if not (np.isfinite(a).all() and np.isfinite(b).all()):
            return "it gives NaN or infinite values on noise"
        if a.shape != b.shape or float(np.abs(a - b).max(initial=0)) > SAME * float(np.abs(b).max(initial=0)):
            return f"it does not give what {other}"
    return ""
