"""Where the network's time goes, by kind of work, from ONNX Runtime's profile.

    python benchmarks/node_times.py elf-vgg-pool2.onnx --size 480x640 --threads 2

Convolutions are the network's and their adjoints'.  All else is overhead: masks and differences (which the graph takes
by depthwise convolutions of one or two taps), max-pooling, products and sums (along channels by 1x1 convolutions), what
only moves values, preprocessing.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
import onnx

from elf_export.graph.graph import GraphView, attributes
from elf_export.graph.response import sums_channels
from elf_runtime.contract import ModelContract
from elf_runtime.image import read
from elf_runtime.model.session import open_session
from elf_runtime.model.subgraph import with_outputs

CONVOLUTIONS = ("Conv", "FusedConv", "QLinearConv", "ConvTranspose", "Gemm", "MatMul", "FusedMatMul")
POOLING = ("MaxPool", "NhwcMaxPool", "AveragePool", "GlobalAveragePool", "QLinearAveragePool", "LRN")
MOVING = (
    "ReorderInput", "ReorderOutput", "Transpose", "Concat", "Slice", "Pad", "DepthToSpace", "Reshape", "Split",
    "Expand", "Squeeze", "Unsqueeze", "QuantizeLinear", "DequantizeLinear", "QLinearConcat", "Cast", "Shape", "Gather",
)  # fmt: skip
KINDS = (
    "convolution",
    "masks and differences",
    "pooling",
    "products and sums",
    "moving values",
    "preprocessing",
)


def kind_of(op: str, name: str, helping: dict[str, str]) -> str:
    """One of `KINDS`, for an executed node of an ELF graph; `helping` is `helping_nodes` of its model."""
    if name.startswith("pre/"):
        return "preprocessing"
    # ONNX Runtime's own endings: of its blocked layout, of fused 8-bit nodes.
    base = re.sub(r"(_nchwc|_token_\d+)$", "", name)
    if base in helping:
        return helping[base]
    if op in CONVOLUTIONS and not name.startswith("saliency/"):
        return "convolution"
    if op in POOLING:
        return "pooling"
    return "moving values" if op in MOVING else "products and sums"


def helping_nodes(model: onnx.ModelProto, layer: str) -> dict[str, str]:
    """Name -> kind of what runs as a convolution and is none of the network's, nor their adjoints, and of masks.

    A convolution that does the same to every channel takes differences, negates or shares out; no trained one does.
    What saturates and is a factor of something is a mask, unless the network up to `layer` does so itself.  Local
    response normalisation sums over channels.
    """
    graph = GraphView(model)
    forward = graph.needed([layer]) if layer in graph.producers() else set()
    found = {}
    for node in graph.nodes:
        if not forward.intersection(node.output) and (_is_alike(graph, node) or _is_mask(graph, node)):
            found[node.name] = "masks and differences"
        kernel = _weights(graph, node.input[1]) if node.op_type == "Conv" and node.name not in found else None
        if kernel is not None and sums_channels(kernel, attributes(node).get("group", 1)):
            found[node.name] = "products and sums"
    return found


def _weights(graph: GraphView, name: str) -> np.ndarray | None:
    """A kernel, or the numbers that it is stored in: 8-bit integers, or bfloat16."""
    maker = graph.producers().get(name)
    stored = maker is not None and maker.op_type in ("DequantizeLinear", "Cast")
    return graph.constant(maker.input[0] if stored else name)


def _is_alike(graph: GraphView, node: onnx.NodeProto) -> bool:
    """Whether the node convolves each channel by itself, and all by the same kernel."""
    if node.op_type != "Conv" or attributes(node).get("group", 1) == 1:
        return False
    kernel = _weights(graph, node.input[1])
    return kernel is not None and bool((kernel == kernel[:1]).all())


def _is_mask(graph: GraphView, node: onnx.NodeProto) -> bool:
    """Whether the node saturates, and its result, which may be rounded or moved, is a factor and nothing else."""
    if node.op_type not in ("HardSigmoid", "Clip"):
        return False
    readers = list(graph.consumers().get(node.output[0], ()))
    for reader in readers:
        if reader.op_type in ("QuantizeLinear", "DequantizeLinear", *MOVING):
            readers += [other for name in reader.output for other in graph.consumers().get(name, ())]
        elif reader.op_type != "Mul" and not _is_alike(graph, reader):
            return False
    return bool(readers)


def node_times(data: bytes, pixels: np.ndarray, repeats: int, threads: int | None) -> dict[tuple[str, str], float]:
    """(name, op) of each executed node -> median milliseconds, without the first two runs."""
    image = onnx.load_from_string(data).graph.input[0]
    dims = {
        d.dim_param: size for d, size in zip(image.type.tensor_type.shape.dim, pixels.shape, strict=True) if d.dim_param
    }
    with tempfile.TemporaryDirectory() as folder:
        session, _ = open_session(data, threads=threads, dims=dims, profile=str(Path(folder) / "profile"))
        for _ in range(repeats + 2):
            session.run(None, {image.name: pixels})
        events = json.loads(Path(session.end_profiling()).read_text(encoding="utf-8"))
    runs = defaultdict(list)
    for event in events:
        if event.get("cat") == "Node" and event["name"].endswith("_kernel_time"):
            runs[event["name"].removesuffix("_kernel_time"), event["args"]["op_name"]].append(event["dur"] / 1000)
    return {node: float(np.median(times[2:])) for node, times in runs.items()}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="+", help="ELF models")
    parser.add_argument("--size", default="480x640", help="HxW that the network sees; default: %(default)s")
    parser.add_argument("--outputs", default="saliency", help="outputs to compute, or all; default: %(default)s")
    parser.add_argument("--image", help="photograph to resize; default: noise")
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--nodes", action="store_true", help="list every node too")
    args = parser.parse_args(arguments)
    height, width = map(int, args.size.split("x"))
    for path in args.models:
        data = Path(path).read_bytes()
        session, name = open_session(data, optimize=False)
        contract = ModelContract.from_metadata(session.get_modelmeta().custom_metadata_map, name)
        channels = contract.input.channels
        picture = np.random.default_rng(0).integers(0, 256, (height, width, channels), np.uint8)
        if args.image:
            picture = cv2.resize(read(args.image), (width, height), interpolation=cv2.INTER_AREA)
            picture = picture if channels == 3 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)[..., None]
        data = data if args.outputs == "all" else with_outputs(data, args.outputs.split(","))
        times = node_times(data, picture[None].astype(np.float32), args.repeats, args.threads)
        helping = helping_nodes(onnx.load_from_string(data), contract.layer)
        total, by_kind = sum(times.values()), dict.fromkeys(KINDS, 0.0)
        for (node, op), time in times.items():
            kind = kind_of(op, node, helping)
            by_kind[kind] += time
            if args.nodes:
                print(f"{time:9.2f} ms  {kind:<22} {op:<18} {node}")
        print(f"{path}: {contract.network} {contract.layer}, {contract.precision}, {args.size}, {total:.1f} ms")
        for kind, time in by_kind.items():
            print(f"  {kind:<22}{time:8.1f} ms {time / total:7.1%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
