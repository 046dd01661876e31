"""Draws docs/images/adjoint-*.svg: a small network's saliency graph, before and after each step of the export.

    python tools/draw_adjoint.py [--out docs/images]

A convolution, a ReLU and a 2x2 max-pool, seeded by the pool's result.  Arithmetic on sizes is left out of the drawings.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np
import onnx
from onnx import helper, numpy_helper

from elf_export.adjoint import build_adjoint
from elf_export.dialect import is_own
from elf_export.graph.graph import Graph, reduce_mean
from elf_export.lowering import lower, write_steps

ROOT = Path(__file__).resolve().parent.parent
WIDTH, HEIGHT, ACROSS, DOWN = 156, 34, 170, 58  # of a box, and from one to the next, in pixels
COLORS = {"network": "#cfd8dc", "dialect": "#ffcc80", "standard": "#bbdefb"}


def network() -> Graph:
    """x (1, 3, 32, 32) - conv - relu - pool."""
    weight = np.random.default_rng(0).standard_normal((8, 3, 3, 3)).astype(np.float32)
    nodes = [
        helper.make_node("Conv", ["x", "w"], ["conv"], name="conv", pads=[1] * 4),
        helper.make_node("Relu", ["conv"], ["relu"], name="relu"),
        helper.make_node("MaxPool", ["relu"], ["pool"], name="pool", kernel_shape=[2, 2], strides=[2, 2]),
    ]
    image = helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, ["N", 3, "H", "W"])
    result = helper.make_tensor_value_info("pool", onnx.TensorProto.FLOAT, None)
    graph = helper.make_graph(nodes, "net", [image], [result], [numpy_helper.from_array(weight, "w")])
    return Graph(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8))


def stages() -> dict[str, Graph]:
    """Name of the drawing -> the graph."""
    dialect = network()
    magnitude = dialect.op("Abs", build_adjoint(dialect, "pool", "x"), name="saliency/abs")
    reduce_mean(dialect, magnitude, 1, "saliency/mean", keepdims=0, output="saliency")
    dialect.set_outputs([helper.make_tensor_value_info("saliency", onnx.TensorProto.FLOAT, None)])
    found = {"dialect": dialect}
    for target in ("plain", "fast", "int8"):
        found[target] = write_steps(lower(Graph(dialect.model), target), target)
    return found


def drawn(graph: Graph) -> str:
    """The graph as SVG, from top to bottom."""
    nodes = [node for node in graph.nodes if graph.dtype(node.output[0]).kind == "f"]
    makers = {name: i for i, node in enumerate(nodes) for name in node.output}
    edges = [sorted({makers[name] for name in node.input if name in makers}) for node in nodes]
    levels: list[int] = []
    for before in edges:
        levels.append(1 + max((levels[i] for i in before), default=0))
    rows = [[i for i, level in enumerate(levels) if level == row] for row in range(1, max(levels) + 1)]
    places = placed(rows, edges)
    right = max(x for x, _ in places.values()) + WIDTH
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-4 -4 {right + 8:.0f} {(len(rows) + 1) * DOWN + 8}" '
        f'width="{right + 8:.0f}" font-family="sans-serif" font-size="11">',
        '<rect x="-4" y="-4" width="100%" height="100%" fill="white"/>',
    ]
    x = right / 2 - WIDTH / 2
    for i, before in enumerate(edges):
        starts = [places[j] for j in before] + ([(x, 0)] if graph.inputs[0] in nodes[i].input else [])
        lines += [line(start, places[i]) for start in starts]
    lines.append(box((x, 0), "image x", "white"))
    for i, node in enumerate(nodes):
        kind = "dialect" if is_own(node) else "standard" if "/" in node.name else "network"
        lines.append(
            box(places[i], node.op_type, COLORS[kind], node.name.rpartition("/")[2] if "/" in node.name else "")
        )
    return "\n".join([*lines, "</svg>", ""])


def placed(rows: Sequence[Sequence[int]], edges: Sequence[Sequence[int]]) -> Mapping[int, tuple[float, float]]:
    """Where each node's box is: rows centred, nodes below the mean of what they read."""
    widest = max(map(len, rows)) * ACROSS
    order: dict[int, tuple[float, float]] = {}
    for row, members in enumerate(rows, start=1):
        wanted = {i: float(np.mean([order[j][0] for j in edges[i]] or [widest / 2])) for i in members}
        ranked = sorted(members, key=lambda i: (wanted[i], i))
        start = (widest - len(ranked) * ACROSS) / 2
        order.update((i, (start + at * ACROSS, row * DOWN)) for at, i in enumerate(ranked))
    return order


def box(at: tuple[float, float], text: str, color: str, role: str = "") -> str:
    """An operator, and below it what it is for."""
    x, y = at
    written = [
        f'<text x="{x + WIDTH / 2:.0f}" y="{y + down:.0f}" text-anchor="middle" fill="{fill}">{escape(line)}</text>'
        for line, down, fill in ((text, 15 if role else 21, "black"), (role, 28, "#546e7a"))
        if line
    ]
    frame = f'<rect x="{x:.0f}" y="{y:.0f}" width="{WIDTH}" height="{HEIGHT}" rx="4" fill="{color}" stroke="#607d8b"/>'
    return frame + "".join(written)


def line(start: tuple[float, float], end: tuple[float, float]) -> str:
    """From the bottom of one box to the top of another, which may be rows below."""
    (x1, y1), (x2, y2) = ((x + WIDTH / 2, y) for x, y in (start, end))
    y1, bend = y1 + HEIGHT, (DOWN - HEIGHT) * 0.9
    curve = f"C{x1:.0f} {y1 + bend:.0f} {x2:.0f} {y2 - bend:.0f} {x2:.0f} {y2:.0f}"
    return f'<path d="M{x1:.0f} {y1:.0f} {curve}" fill="none" stroke="#90a4ae"/>'


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images")
    out = parser.parse_args(arguments).out
    for name, graph in stages().items():
        path = out / f"adjoint-{name}.svg"
        path.write_text(drawn(graph), encoding="utf-8")
        print(f"{path}: {len(graph.nodes)} nodes")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
