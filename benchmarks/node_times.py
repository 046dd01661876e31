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

from elf_export.adjoint.registry import ADJOINT
from elf_export.graph.graph import attributes
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


def helping_nodes(model: onnx.ModelProto) -> dict[str, str]:
    """Name -> kind of what runs as a convolution and is none of the network's, nor their adjoints, and of masks.

    Those are the adjoint's steps, its depthwise convolutions, and local response normalisation's sums over channels.
    The adjoint of a depthwise layer of the network is a convolution like any other: its role is "dx".
    """
    constants = {tensor.name: tensor for tensor in model.graph.initializer}
    # In bf16 files weights are cast to float32 where they are read.
    constants |= {
        node.output[0]: constants[node.input[0]]
        for node in model.graph.node
        if node.op_type == "Cast" and node.input[0] in constants
    }
    found = {}
    for node in model.graph.node:
        grouped = node.op_type == "Conv" and attributes(node).get("group", 1) > 1
        role = node.name.rsplit("/", 1)[-1]
        helps = grouped and (not role.startswith("dx") or role.endswith("_minus"))
        if node.name.startswith(ADJOINT) and (helps or node.op_type in ("HardSigmoid", "Clip")):
            found[node.name] = "masks and differences"
        elif node.op_type == "Conv" and node.input[1] in constants:
            kernel = onnx.numpy_helper.to_array(constants[node.input[1]])
            if sums_channels(kernel, attributes(node).get("group", 1)):
                found[node.name] = "products and sums"
    return found


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
        helping = helping_nodes(onnx.load_from_string(data))
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
