"""An ELF model with its post-processing in the graph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import onnx
from onnx import TensorProto, helper

from elf_export.errors import ExportError
from elf_export.graph.graph import Graph
from elf_runtime import DescriptorSpec, DetectionParams, ModelContract

from .describe import described
from .emit import DOUBLE, FLOAT, Emit, f32, f64, i64
from .levels import scores_and_level
from .places import (
    allowed_pixels,
    contrast_window,
    enough_contrast,
    looked_up,
    mask_border,
    shrunk,
    textured,
    within_border,
)
from .refine import quadratic_peaks, split
from .resize import Working, working_image
from .suppress import Window, greedy, strongest, window_maxima

LEAST_OPSET = 14  # CumSum, Pad, Squeeze with axes as an input; Max and Min of all number types
IMAGE, MASK, MOST, THRESHOLD = "image", "mask", "max_keypoints", "threshold"
KEYPOINTS, SCORES, DESCRIPTORS = "keypoints", "scores", "descriptors"


@dataclass(frozen=True)
class Form:
    """How the graph is written.

    Attributes
    ----------
    pixels : "uint8" or "float32"
        Of the image input; floats have the range of the bytes, 0 to 255.
    rounds : int
        Of the suppression, unrolled; 0 is a Loop of as many as are needed.
    """

    pixels: str = "uint8"
    rounds: int = 0


def refusals(contract: ModelContract, opset: int) -> list[str]:
    """Why a model's post-processing can't be in its graph, in words; empty where it can."""
    params = contract.detection
    found = []
    if opset < LEAST_OPSET:
        found.append(f"opset {opset}; --opset {LEAST_OPSET} or later has the ops")
    if contract.input.is_fixed:
        found.append("images of one size only")
    for unwanted, name in (
        (bool(params.scales), "scales"),
        (params.oriented, "oriented"),
        (params.grid != (1, 1), "grid"),
    ):
        if unwanted:
            found.append(f"the setting {name}")
    if not isinstance(params.max_side, str):
        found.append("the setting max_side")
    return found


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
        Inputs: ``image`` (1, H, W, 1 or 3), and with defaults: ``max_keypoints`` int64 (), ``threshold`` float32 ()
        (a fraction; below 0 is Kapur's level) and ``mask`` uint8 (H, W), or (1, 1) for none.
        Outputs: ``keypoints`` (K, 2) float32, x and y in pixels of the image, ``scores`` (K,) float32, descending, and
        ``descriptors`` (K, D) float32 of unit length, where the model has a descriptor, its first.

    Raises
    ------
    ExportError
        If that can't be; see `refusals`.
    """
    graph = Graph(model)
    if why := refusals(contract, graph.opset):
        raise ExportError(f"--end-to-end: the graph can't hold {', '.join(why)}")
    spec, inner = contract.descriptor(), contract.input.name
    first = graph.nodes[0]
    renamed = graph.unique("network_input") if inner == IMAGE else inner
    if inner == IMAGE:
        graph.rename({IMAGE: renamed})
        first = graph.nodes[0]
    with graph.insert_before(first):
        working = working_image(Emit(graph, "resize"), IMAGE, contract.input, contract.detection.scale)
        graph.op("Identity", working.pixels, name="post/resize/network", outputs=[renamed])
    _post(graph, working, contract, spec, form)
    _signature(graph, contract, spec, form)
    graph.prune()
    onnx.checker.check_model(graph.model)
    return graph.model


def _post(graph: Graph, working: Working, contract: ModelContract, spec: DescriptorSpec | None, form: Form) -> None:
    params = contract.detection
    e = Emit(graph, "places")
    inside = shrunk(e, MASK, mask_border(e, params, contract.receptive_field, working.scale))
    allowed = allowed_pixels(e, inside, working)
    scores, level = scores_and_level(Emit(graph, "levels"), contract.saliency_output, params, allowed, THRESHOLD)
    passed = _passed(graph, working, contract, scores, level, allowed)
    e = Emit(graph, "suppress")
    window = Window.of(e, params.nms_radius, params.scale, working.scale, one_for_all=form.rounds > 0)
    if params.suppression == "maxima":
        passed = e("And", passed, window_maxima(e, scores, window))
    taken = greedy(e, scores, passed, window, form.rounds)
    values, flat = strongest(e, scores, taken, MOST)
    x, y = _placed(graph, working, params, scores, flat, inside)
    e = Emit(graph, "outputs")
    columns = [e.column(e.cast(working.to_source(e, at, axis), FLOAT)) for at, axis in ((x, 1), (y, 0))]
    e("Concat", *columns, axis=1, outputs=[KEYPOINTS])
    e("Identity", values, outputs=[SCORES])
    if spec is not None:
        found = described(Emit(graph, "describe"), spec, x, y)
        e("Identity", found, outputs=[DESCRIPTORS])


def _passed(graph: Graph, working: Working, contract: ModelContract, scores: str, level: str, allowed: str) -> str:
    """(1, 1, h, w) bool: the pixels that may be keypoints, before any suppresses another."""
    params, e = contract.detection, Emit(graph, "passed")
    conditions = [allowed, within_border(e, params.border, working), textured(e, working.pixels)]
    if params.min_contrast > 0:
        side = contrast_window(contract.receptive_field)
        least = params.min_contrast * contract.input.value_range / 255
        conditions.append(enough_contrast(e, working.pixels, contract.input.channels, side, least))
    places = e("Unsqueeze", e.both(*conditions), np.array([0, 1], i64))
    reached = e("And", e("Not", e("Less", scores, level)), e("Greater", scores, f32(0)))
    return e("And", places, reached)


def _placed(
    graph: Graph, working: Working, params: DetectionParams, scores: str, flat: str, inside: str
) -> tuple[str, str]:
    """x and y in working pixels, (K,) float64: refined, but where that would leave what border and mask allow."""
    e = Emit(graph, "refine")
    x, y = split(e, flat, working.working[1])
    whole = (e.cast(x, DOUBLE), e.cast(y, DOUBLE))
    if not params.subpixel:
        return whole
    # The runtime's places are float32 in between.
    refined = tuple(e.cast(e.cast(v, FLOAT), DOUBLE) for v in quadratic_peaks(e, scores, x, y, working.working))
    stays = [looked_up(e, inside, *refined, working)]
    if params.border:
        for at, axis in ((refined[0], 1), (refined[1], 0)):
            place = working.to_source(e, at, axis)
            most = e.cast(e("Sub", working.source[axis], i64(1 + params.border)), DOUBLE)
            stays += [e("Not", e("Less", place, f64(params.border))), e("Not", e("Greater", place, most))]
    kept = e.both(*stays)
    return e("Where", kept, refined[0], whole[0]), e("Where", kept, refined[1], whole[1])


def _signature(graph: Graph, contract: ModelContract, spec: DescriptorSpec | None, form: Form) -> None:
    """Inputs and outputs; the optional inputs' defaults are initializers of the same names."""
    params, proto = contract.detection, graph.model.graph
    kind = {"uint8": TensorProto.UINT8, "float32": TensorProto.FLOAT}[form.pixels]
    fixed = {"kapur": -1.0, "none": 0.0}
    threshold = fixed[params.threshold] if isinstance(params.threshold, str) else params.threshold
    defaults = {
        MOST: np.array(params.max_keypoints, i64),
        THRESHOLD: np.array(threshold, f32),
        MASK: np.ones((1, 1), np.uint8),
    }
    infos = [helper.make_tensor_value_info(IMAGE, kind, [1, "H", "W", "C"])]
    for name, value in defaults.items():
        proto.initializer.append(onnx.numpy_helper.from_array(value, name))
        shape = ["mask_height", "mask_width"] if name == MASK else []
        infos.append(helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(value.dtype), shape))
    del proto.input[:]
    proto.input.extend(infos)
    outputs = [(KEYPOINTS, ["K", 2]), (SCORES, ["K"])] + ([(DESCRIPTORS, ["K", spec.dim])] if spec else [])
    graph.set_outputs([helper.make_tensor_value_info(name, FLOAT, shape) for name, shape in outputs])
    graph.reindex()
