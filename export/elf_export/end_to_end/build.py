"""An ELF model with its post-processing in the graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import onnx
from onnx import TensorProto, helper

from elf_export.errors import ExportError
from elf_export.graph.graph import Graph
from elf_export.graph.passes import portable_forms
from elf_runtime import DescriptorSpec, ModelContract

from .emit import FLOAT, INT64, Emit, Value, f32, i64
from .keypoints import MASK, MOST, THRESHOLD, Maps, keypoints_of
from .resize import Working, working_image

LEAST_OPSET = 14  # CumSum, Pad, Squeeze with axes as an input; Max and Min of all number types
IMAGE = "image"
PIXELS, COLORS = ("uint8", "float32"), ("bgr", "rgb")


@dataclass(frozen=True)
class Form:
    """How the graph is written.

    Attributes
    ----------
    pixels : "uint8" or "float32"
        Of the image input; floats have the range of the bytes, 0 to 255.
    color : "bgr" or "rgb"
        Order of the image's channels: OpenCV's, or that of most other libraries.
    batch : bool
        Several images of one size at once; outputs are padded.
    rounds : int
        Of the suppression, unrolled, with the same window for small images too; 0 is a Loop of as many as are needed.
    saliency : bool
        The network's saliency map as a last output, at the working size.
    """

    pixels: str = "uint8"
    color: str = "bgr"
    batch: bool = False
    rounds: int = 0
    saliency: bool = False

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
        kinds += ["batch"] * self.batch + ["saliency"] * self.saliency
        return ["--end-to-end", *kinds] + (["--rounds", str(self.rounds)] if self.rounds else [])

    @property
    def outputs(self) -> tuple[tuple[str, int, list[str | int]], ...]:
        """Name, element type and shape of each output but descriptors and saliency."""
        if self.batch:
            return (
                ("keypoints", FLOAT, ["N", "M", 2]), ("scores", FLOAT, ["N", "M"]), ("counts", INT64, ["N"]),
            )  # fmt: skip
        return ("keypoints", FLOAT, ["K", 2]), ("scores", FLOAT, ["K"])


def refusals(contract: ModelContract, opset: int) -> list[str]:
    """Why a model's post-processing can't be in its graph, in words; empty where it can."""
    params = contract.detection
    found = []
    if opset < LEAST_OPSET:
        found.append(f"the ops that it needs at opset {opset} (they come with opset {LEAST_OPSET})")
    if contract.input.is_fixed or contract.input.batch:
        found.append("images of any size for a network of one size")
    settings = {
        "scales": bool(params.scales),
        "oriented": params.oriented,
        "grid": params.grid != (1, 1),
        "max_side": params.max_side != "none",
    }
    return found + [f"the setting {name}" for name, is_set in settings.items() if is_set]


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
        defaults: ``max_keypoints`` int64 (), ``threshold`` float32 () (a fraction of the range; below 0 is Kapur's
        level) and ``mask`` uint8 (H, W), or (1, 1) for none.
        Outputs: ``keypoints`` (K, 2) float32, x and y in pixels of the image, ``scores`` (K,) float32, descending, and
        ``descriptors`` (K, D) float32 of unit length, where the model has a descriptor, its first.  With batches
        (N, M, 2), (N, M), (N, M, D), M being ``max_keypoints``, zeros behind the ``counts`` (N,) int64 of each image.
        If the form has it, ``saliency`` (N, h, w) float32 too, as the network gives it at the working size.

    Raises
    ------
    ExportError
        If that can't be; see `refusals`.
    """
    graph = Graph(model)
    if why := refusals(contract, graph.opset):
        raise ExportError(f"--end-to-end: a graph can't hold {', nor '.join(why)}")
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
    onnx.checker.check_model(graph.model)
    return graph.model


def _names(form: Form, spec: DescriptorSpec | None) -> list[str]:
    return [name for name, _, _ in form.outputs] + ["descriptors"] * (spec is not None)


def _of_image(graph: Graph, working: Working, contract: ModelContract, spec: DescriptorSpec | None, form: Form) -> None:
    maps = Maps(contract.saliency_output, spec.output if spec else None)
    found = keypoints_of(graph, working, maps, contract, form.rounds)
    _outputs(graph, [value for value in found if value is not None], _names(form, spec))


def _of_batch(graph: Graph, working: Working, contract: ModelContract, spec: DescriptorSpec | None, form: Form) -> None:
    e = Emit(graph, "batch")

    def one(number: str) -> Sequence[str]:
        def mine(x: str) -> str:
            return e("Gather", x, e("Reshape", number, np.array([1], i64)), axis=0)

        own = replace(working, pixels=mine(working.pixels))
        maps = Maps(mine(contract.saliency_output), mine(spec.output) if spec else None)
        keypoints, scores, descriptors = keypoints_of(graph, own, maps, contract, form.rounds)
        count = e.size(scores, 0)
        padded = [_padded(e, keypoints, count, 2), _padded(e, scores, count, 1), count]
        return padded if descriptors is None else [*padded, _padded(e, descriptors, count, 2)]

    kinds = [(kind, len(shape) - 1) for _, kind, shape in form.outputs] + [(FLOAT, 2)] * (spec is not None)
    _outputs(graph, e.for_each(e.size(IMAGE, 0), kinds, one), _names(form, spec))


def _padded(e: Emit, rows: str, count: str, rank: int) -> str:
    """Rows, (K, ...), with zeros behind them: as many as `max_keypoints`."""
    behind = e("Reshape", e("Sub", MOST, count), np.array([1], i64))
    pads: list[Value] = [np.zeros(rank, i64), behind, np.zeros(rank - 1, i64)]
    return e("Pad", rows, e("Concat", *pads[: rank + 1], axis=0))


def _outputs(graph: Graph, values: Sequence[str], names: Sequence[str]) -> None:
    for value, name in zip(values, names, strict=True):
        graph.op("Identity", value, name=f"post/outputs/{name}", outputs=[name])


def _signature(graph: Graph, contract: ModelContract, spec: DescriptorSpec | None, form: Form) -> None:
    """Inputs and outputs; the optional inputs' defaults are initializers of the same names."""
    params, proto = contract.detection, graph.model.graph
    kind = {"uint8": TensorProto.UINT8, "float32": TensorProto.FLOAT}[form.pixels]
    words = {"kapur": -1.0, "none": 0.0}
    threshold = words[params.threshold] if isinstance(params.threshold, str) else params.threshold
    infos = [helper.make_tensor_value_info(IMAGE, kind, ["N" if form.batch else 1, "H", "W", "C"])]
    for name, value, shape in (
        (MOST, np.array(params.max_keypoints, i64), []),
        (THRESHOLD, np.array(threshold, f32), []),
        (MASK, np.ones((1, 1), np.uint8), ["mask_height", "mask_width"]),
    ):
        proto.initializer.append(onnx.numpy_helper.from_array(value, name))
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
