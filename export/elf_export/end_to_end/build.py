"""An ELF model with its post-processing in the graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper

from elf_export.errors import ExportError
from elf_export.graph.graph import Graph
from elf_export.graph.passes import pad_behind, portable_forms
from elf_runtime import DescriptorSpec, DetectionParams, ModelContract
from elf_runtime.contract import EndToEndSpec

from .emit import FLOAT, INT64, Emit, Value, f32, i64
from .keypoints import MASK, MOST, THRESHOLD, Maps, keypoints_of
from .resize import Working, working_image

LEAST_OPSET = 14  # CumSum, Pad, Squeeze with axes as an input; Max and Min of all number types
IMAGE = "image"
PIXELS, COLORS = ("uint8", "float32"), ("bgr", "rgb")


@dataclass(frozen=True)
class Form(EndToEndSpec):
    """What an end-to-end graph takes and gives, with the attributes that its file says of itself."""

    def __post_init__(self) -> None:
        if self.pixels not in PIXELS:
            raise ExportError(f"--end-to-end: pixels are {' or '.join(PIXELS)}, not {self.pixels!r}")
        if self.color not in COLORS:
            raise ExportError(f"--end-to-end: channels are in the order {' or '.join(COLORS)}, not {self.color!r}")
        if self.rounds < 0:
            raise ExportError(f"--end-to-end: {self.rounds} rounds; it is a number from 0 on")

    def words(self) -> list[str]:
        """The options of the command that ask for it."""
        kinds = [self.pixels] * (self.pixels != PIXELS[0]) + [self.color] * (self.color != COLORS[0])
        kinds += [word for word in ("batch", "saliency", "required", "opencv") if getattr(self, word)]
        return ["--end-to-end", *kinds] + (["--rounds", str(self.rounds)] if self.rounds else [])

    @property
    def spec(self) -> EndToEndSpec:
        """What the file says of it."""
        return EndToEndSpec(**asdict(self))

    @property
    def outputs(self) -> tuple[tuple[str, int, list[str | int]], ...]:
        """Name, element type and shape of each output but descriptors and saliency."""
        if self.batch:
            return (
                ("keypoints", FLOAT, ["N", "M", 2]), ("scores", FLOAT, ["N", "M"]), ("counts", INT64, ["N"]),
            )  # fmt: skip
        return ("keypoints", FLOAT, ["K", 2]), ("scores", FLOAT, ["K"])


def require_possible(params: DetectionParams, opset: int, fixed: bool = False) -> None:
    """Raise ExportError where post-processing with these settings can't be in a graph, saying why.

    `fixed` is whether the network takes one size of images or batches only.
    """
    found = []
    if opset < LEAST_OPSET:
        found.append(f"the ops that it needs at opset {opset} (they come with opset {LEAST_OPSET})")
    if fixed:
        found.append("images of any size for a network of one size")
    settings = {
        "scales": bool(params.scales),
        "oriented": params.oriented,
        "grid": params.grid != (1, 1),
        "max_side": params.max_side != "none",
    }
    found += [f"the setting {name}" for name, is_set in settings.items() if is_set]
    if found:
        raise ExportError(f"--end-to-end: a graph can't hold {', nor '.join(found)}")


def end_to_end(model: onnx.ModelProto, contract: ModelContract, form: Form = Form()) -> onnx.ModelProto:
    """The model with image in and keypoints out.

    Parameters
    ----------
    model : onnx.ModelProto
        A finished ELF model; left as it is.
    contract : ModelContract
        Its, whose detection settings are frozen into the graph.

    Returns
    -------
    onnx.ModelProto
        Inputs: ``image`` (N, H, W, 1 or 3), grey or in `form`'s order, N = 1 unless `form` has batches, and with
        defaults, unless `form` requires them: ``max_keypoints`` int64 (), ``threshold`` float32 () (a fraction of the
        range; below 0 is Kapur's level) and ``mask`` uint8 (H, W), or (1, 1) for none.
        Outputs: ``keypoints`` (K, 2) float32, x and y in pixels of the image, ``scores`` (K,) float32, descending, and
        ``descriptors`` (K, D) float32 of unit length, where the model has a descriptor, its first.  With batches
        (N, M, 2), (N, M), (N, M, D), M being ``max_keypoints``, zeros behind the ``counts`` (N,) int64 of each image.
        If the form has it, ``saliency`` (N, h, w) float32 too, as the network gives it at the working size.

    Raises
    ------
    ExportError
        If that can't be; see `require_possible`.
    """
    graph = Graph(model)
    require_possible(contract.detection, graph.opset, bool(contract.input.is_fixed or contract.input.batch))
    inner = graph.unique("network_input")
    graph.rename({contract.input.name: inner})
    with graph.insert_before(graph.nodes[0]):
        working = working_image(Emit(graph, "resize"), IMAGE, contract.input, contract.detection.scale, form.color)
        graph.op("Identity", working.pixels, name="post/resize/network", outputs=[inner])
    spec = contract.descriptor()
    (_of_batch if form.batch else _of_image)(graph, working, contract, spec, form)
    _signature(graph, contract, spec, form)
    graph.prune()
    portable_forms(graph)
    if form.opencv:
        pad_behind(graph)
    onnx.checker.check_model(graph.model)
    return graph.model


def inputs_of(params: DetectionParams) -> dict[str, npt.NDArray[Any]]:
    """What the settings say of the inputs beside the image: max_keypoints, threshold, and a mask that is none."""
    words = {"kapur": -1.0, "none": 0.0}
    threshold = words[params.threshold] if isinstance(params.threshold, str) else params.threshold
    return {
        MOST: np.array(params.max_keypoints, i64),
        THRESHOLD: np.array(threshold, f32),
        MASK: np.ones((1, 1), np.uint8),
    }


def _names(form: Form, spec: DescriptorSpec | None) -> list[str]:
    return [name for name, _, _ in form.outputs] + ["descriptors"] * (spec is not None)


def _of_image(graph: Graph, working: Working, contract: ModelContract, spec: DescriptorSpec | None, form: Form) -> None:
    maps = Maps(contract.saliency_output, spec.output if spec else None)
    found, e = keypoints_of(graph, working, maps, contract, form.rounds), Emit(graph, "kept")
    _outputs(graph, [_first(e, rows, found.count, 0) for rows in found.rows], _names(form, spec))


def _of_batch(graph: Graph, working: Working, contract: ModelContract, spec: DescriptorSpec | None, form: Form) -> None:
    e = Emit(graph, "batch")

    def one(number: str) -> Sequence[str]:
        def mine(x: str) -> str:
            return e("Gather", x, e("Reshape", number, np.array([1], i64)), axis=0)

        own = replace(working, pixels=mine(working.pixels))
        maps = Maps(mine(contract.saliency_output), mine(spec.output) if spec else None)
        found = keypoints_of(graph, own, maps, contract, form.rounds)
        padded = [_padded(e, rows, found.count, rank) for rows, rank in zip(found.rows, (2, 1, 2), strict=False)]
        return [*padded[:2], found.count, *padded[2:]]

    kinds = [(kind, len(shape) - 1) for _, kind, shape in form.outputs] + [(FLOAT, 2)] * (spec is not None)
    most, names = e("Max", MOST, i64(0)), _names(form, spec)
    found = zip(e.for_each(e.size(IMAGE, 0), kinds, one), names, strict=True)
    _outputs(graph, [x if name == "counts" else _first(e, x, most, 1) for x, name in found], names)


def _first(e: Emit, x: str, count: str, axis: int) -> str:
    """The first `count`, int64 (), along an axis."""
    return e("Slice", x, np.array([0], i64), e("Reshape", count, np.array([1], i64)), np.array([axis], i64))


def _padded(e: Emit, rows: str, count: str, rank: int) -> str:
    """The first `count` of rows, (K, ...), with zeros behind them: as many as `max_keypoints`, or one."""
    made = e.size(rows, 0)
    kept = e("Less", e.count(made), count)
    rows = e("Where", e.column(kept) if rank > 1 else kept, rows, f32(0))
    behind = e("Reshape", e("Sub", e("Max", MOST, i64(1)), made), np.array([1], i64))
    pads: list[Value] = [np.zeros(rank, i64), behind, np.zeros(rank - 1, i64)]
    return e("Pad", rows, e("Concat", *pads[: rank + 1], axis=0))


def _outputs(graph: Graph, values: Sequence[str], names: Sequence[str]) -> None:
    for value, name in zip(values, names, strict=True):
        graph.op("Identity", value, name=f"post/outputs/{name}", outputs=[name])


def _signature(graph: Graph, contract: ModelContract, spec: DescriptorSpec | None, form: Form) -> None:
    """Inputs and outputs; defaults of inputs are initializers of the same names."""
    proto = graph.model.graph
    kind = {"uint8": TensorProto.UINT8, "float32": TensorProto.FLOAT}[form.pixels]
    infos = [helper.make_tensor_value_info(IMAGE, kind, ["N" if form.batch else 1, "H", "W", "C"])]
    for name, value in inputs_of(contract.detection).items():
        if not form.required:
            proto.initializer.append(onnx.numpy_helper.from_array(value, name))
        shape = ["mask_height", "mask_width"] if name == MASK else []
        infos.append(helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(value.dtype), shape))
    del proto.input[:]
    proto.input.extend(infos)
    outputs = list(form.outputs)
    if spec is not None:
        outputs.append(("descriptors", FLOAT, [*outputs[0][2][:-1], spec.dim]))
    if form.saliency:
        outputs.append((contract.saliency_output, FLOAT, ["N" if form.batch else 1, "h", "w"]))
    graph.set_outputs([helper.make_tensor_value_info(*output) for output in outputs])
    graph.reindex()
