"""Which image sizes a network takes: freeing those that its file fixes without need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime as ort

from elf_export.errors import ExportError
from elf_runtime.errors import first_line

from .image_input import ImageInput

MULTIPLES = (1, 2, 4, 8, 16, 32, 64)
LEAST = (32, 48, 64, 96, 128, 224)
PROBE = (96, 128)  # about so many pixels of height and width
SAME = 1e-3  # of the largest value: what two kernels of one network may differ by in float32

Map = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Sizes:
    """The sizes that the network takes; 0 where any does.

    Attributes
    ----------
    height, width, batch : int
        What is fixed, 0 where free.
    multiple : int
        Free heights and widths are multiples of it.
    min_size : int
        Smallest free height and width.
    """

    height: int = 0
    width: int = 0
    batch: int = 0
    multiple: int = 1
    min_size: int = LEAST[0]

    def near(self, height: int, width: int) -> tuple[int, int]:
        """The size that the network takes next to a wanted one; an odd multiple stays odd."""
        h, w = (max(round(v / self.multiple), 1) * self.multiple for v in (height, width))
        return self.height or max(h, self.min_size), self.width or max(w, self.min_size)

    def describe(self) -> str:
        """In words, for the log."""
        if self.height and self.width:
            size = f"{self.width}x{self.height} only"
        elif self.height or self.width:
            size = (
                f"{'height' if self.height else 'width'} {self.height or self.width} only, the other is free"
            )
        else:
            size = "any" if self.multiple == 1 else f"multiples of {self.multiple}"
            size += f" from {self.min_size}x{self.min_size}"
        return size + (f"; {self.batch} image(s) at a time" if self.batch else "")


def free_sizes(model: onnx.ModelProto, image: ImageInput) -> tuple[onnx.ModelProto, Sizes]:
    """`model` with as few fixed sizes as it runs with.

    A file often fixes the size that it was exported with although no node depends on it.  All three are
    tried free, then the batch and the image each alone, by running: a graph of symbols would prove nothing,
    as a Reshape to constants is valid ONNX for any size.  At the file's own size the result must stay the
    same, and a batch must give what its images give one by one.

    Returns
    -------
    (model, sizes)
        The model's stale shapes are dropped, those of free axes are symbols.

    Raises
    ------
    ExportError
        If the model doesn't run at all, or only on batches of several images.
    """
    batch, height, width = image.size
    attempts = [
        Sizes(),
        Sizes(batch=batch or 0),
        Sizes(height=height or 0),
        Sizes(height or 0, width or 0),
        Sizes(height or 0, width or 0, batch or 0),
    ]
    expected = _Runner(model, image).outputs_at(image.size) if None not in image.size else None
    tried, reason = set(), ""
    for attempt in attempts:
        if attempt in tried:
            continue
        tried.add(attempt)
        freed = with_sizes(model, image, attempt)
        try:
            found = _works(_Runner(freed, image), attempt, image, expected)
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


def with_sizes(model: onnx.ModelProto, image: ImageInput, sizes: Sizes) -> onnx.ModelProto:
    """A copy of `model` whose image has the fixed sizes of `sizes`, and symbols N, H, W elsewhere."""
    result = onnx.ModelProto()
    result.CopyFrom(model)
    fixed = {"N": sizes.batch, "H": sizes.height, "W": sizes.width, "C": image.channels}
    for value in result.graph.input:
        if value.name == image.name:
            del value.type.tensor_type.shape.dim[:]
            for axis in image.layout:
                dim = value.type.tensor_type.shape.dim.add()
                if fixed[axis]:
                    dim.dim_value = fixed[axis]
                else:
                    dim.dim_param = axis
    del result.graph.value_info[:]
    for value in result.graph.output:
        value.type.tensor_type.ClearField("shape")
    return result


class _Runner:
    """Runs a model on noise."""

    def __init__(self, model: onnx.ModelProto, image: ImageInput) -> None:
        options = ort.SessionOptions()
        options.log_severity_level = 4
        self.session = ort.InferenceSession(model.SerializeToString(), options, ["CPUExecutionProvider"])
        self.image = image

    def outputs(self, pixels: Map) -> list[Map]:
        values: list[Map] = self.session.run(None, {self.image.name: pixels})
        return values

    def outputs_at(self, size: Sequence[int | None]) -> list[Map]:
        return self.outputs(self.noise(*(int(v or 1) for v in size)))

    def noise(self, batch: int, height: int, width: int) -> Map:
        axes = {"N": batch, "C": self.image.channels, "H": height, "W": width}
        values = np.random.default_rng(0).standard_normal([axes[a] for a in self.image.layout])
        return values.astype(np.float32)


def _works(runner: _Runner, sizes: Sizes, image: ImageInput, expected: list[Map] | None) -> Sizes | str:
    """`sizes` with the multiple and the smallest size that the model needs, why not if it takes none of them."""
    if expected is not None and (
        reason := _unlike(runner.outputs_at(image.size), expected, "the file as it stands")
    ):
        return reason
    multiple = next((m for m in MULTIPLES if not _fails(runner, sizes, _probe(m))), None)
    if multiple is None:
        return _fails(runner, sizes, _probe(MULTIPLES[-1]))
    least = next((s for s in LEAST if s % multiple == 0 and not _fails(runner, sizes, (s, s))), None)
    if least is None:
        return _fails(runner, sizes, (LEAST[-1], LEAST[-1]))
    return Sizes(sizes.height, sizes.width, sizes.batch, multiple, least)


def _probe(multiple: int) -> tuple[int, int]:
    """About PROBE pixels: an odd and an even multiple, as rounding differs between the two."""
    h, w = (max(round(v / multiple), 1) for v in PROBE)
    return (h | 1) * multiple, (w + w % 2) * multiple


def _fails(runner: _Runner, sizes: Sizes, size: tuple[int, int]) -> str:
    """Why the model does not take images of a size; empty if it does."""
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
    return _unlike(
        together, [np.concatenate(maps) for maps in zip(*apart, strict=True)], "each of its images alone"
    )


def _unlike(found: list[Map], wanted: list[Map], other: str) -> str:
    """How results differ from wanted ones, those of `other`; empty if they don't."""
    for a, b in zip(found, wanted, strict=True):
        if not (np.isfinite(a).all() and np.isfinite(b).all()):
            return "it gives NaN or infinite values on noise"
        if a.shape != b.shape or float(np.abs(a - b).max(initial=0)) > SAME * float(np.abs(b).max(initial=0)):
            return f"it does not give what {other} gives"
    return ""
