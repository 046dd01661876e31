"""Which values are maps of the image, and where their axes lie."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import onnx

from .graph import SIZES, GraphView, attributes

# What makes (N, C, H, W) of its input, whatever a Reshape has done to that one's axes before.
WINDOWED = frozenset({
    "Conv", "ConvTranspose", "MaxPool", "AveragePool", "LpPool", "GlobalAveragePool", "GlobalMaxPool",
    "BatchNormalization", "InstanceNormalization", "LRN", "DepthToSpace", "SpaceToDepth",
})  # fmt: skip
CHANNEL_MAKERS = frozenset({"Conv", "ConvTranspose", "DepthToSpace", "SpaceToDepth"})
REGROUPING = frozenset({"Reshape", "Flatten", "Squeeze", "Unsqueeze"})
TAKES_APART = frozenset({"Einsum", "GatherND", "ScatterND", "If", "Loop", "Scan"})

# A letter of NCHW and how many places of it; "?" for places that were repeated from one, a tuple for places that
# were counted together (the tokens of a transformer, H W) and then grew or shrank, by a class token.
Part = tuple["str | tuple[Part, ...]", int]
Axis = tuple[Part, ...]  # outermost first; none for an axis of one place
Axes = tuple[Axis, ...]


def axes_of(graph: GraphView, image: str, layout: str, sizes: Mapping[str, Sequence[int]]) -> dict[str, str]:
    """The layout, "NCHW" or another order, of every value of rank 4 that is a map of the image.

    Every axis is followed from the image on: a Transpose moves it, a Reshape splits it or joins it with others,
    a product of matrices replaces one by channels.  Of H or W the outer part of a split stays what it was, the
    inner one (the pixels of a cell) counts as channels.  A map has each of the four axes; an attention map, which has
    H and W on one axis, has not, nor have the windows that an image was cut into.

    Parameters
    ----------
    sizes : of values
        Where the sizes of a Reshape's output are not among them, the value is no map.
    """
    found: dict[str, Axes] = {image: tuple(map(_axis, layout, sizes.get(image, [0] * 4)))}
    reached = {image}
    for node in graph.nodes:
        if node.op_type in SIZES or not reached.intersection(node.input):
            continue
        reached.update(node.output)
        for name in filter(None, node.output):
            rank = graph.rank(name) if name not in sizes else len(sizes[name])
            if rank is None:
                continue
            after = sizes.get(name, [0] * rank)
            axes = _after(node, found, reached, after)
            if axes is not None:
                found[name] = axes
    letters = {name: _letters(axes) for name, axes in found.items() if len(axes) == 4}
    return {name: text for name, text in letters.items() if text is not None}


def _axis(letter: str, size: int) -> Axis:
    return () if size == 1 else ((letter, size),)


def _letters(axes: Axes) -> str | None:
    """Each axis's letter, None if they are not those of a map; axes of one place get the letters that are left."""
    known = [_letter(axis) for axis in axes]
    left = [letter for letter in "NCHW" if letter not in known]
    text = "".join(left.pop(0) if letter == "?" else letter for letter in known if letter != "?" or left)
    return text if sorted(text) == sorted("NCHW") else None


def _letter(axis: Axis) -> str:
    """ "?" if any would do, "" if none does."""
    if not axis or [letter for letter, _ in axis] == ["?"]:
        return "?"
    letter = axis[0][0]
    return letter if isinstance(letter, str) and letter in "NCHW" and len(axis) == 1 else ""


def _after(
    node: onnx.NodeProto, found: Mapping[str, Axes], reached: Collection[str], after: Sequence[int]
) -> Axes | None:
    """The axes of an output of size `after`; None where they can't be told."""
    op, attrs, inputs = node.op_type, attributes(node), node.input
    first = found.get(inputs[0])
    if op in WINDOWED and len(after) == 4:
        axes = first if first is not None and len(first) == 4 else tuple(map(_axis, "NCHW", after))
        axes = _resized(axes, after)
        return (axes[0], _axis("C", after[1]), *axes[2:]) if op in CHANNEL_MAKERS else axes
    if op in TAKES_APART:
        return None
    if op in REGROUPING:
        return None if first is None else _regrouped(first, after)
    if op == "Transpose":
        perm = attrs.get("perm") or range(len(after))[::-1]
        return None if first is None else tuple(first[i] for i in perm)
    if op in ("MatMul", "Gemm"):
        if attrs.get("transA") or any(name in reached and name not in found for name in inputs[:2]):
            return None
        return _product(first, found.get(inputs[1]), after)
    if op == "Gather" and first is not None and len(first) == len(after) + 1:
        axis = attrs.get("axis", 0) % len(first)
        return _resized(first[:axis] + first[axis + 1 :], after)
    return _together([found[name] for name in inputs if name in found], after)


def _product(a: Axes | None, b: Axes | None, after: Sequence[int]) -> Axes | None:
    """(..., M, K) by (..., K, L): a factor that does not come from the image brings channels."""
    if len(after) < 2 or any(axes is not None and len(axes) < 2 for axes in (a, b)):
        return None
    batch = _together([axes[:-2] for axes in (a, b) if axes is not None], after[:-2])
    rows = a[-2] if a is not None else _axis("C", after[-2])
    columns = b[-1] if b is not None else _axis("C", after[-1])
    return None if batch is None else (*batch, rows, columns)


def _together(several: Sequence[Axes], after: Sequence[int]) -> Axes | None:
    """What inputs that broadcast to each other make; None if they don't agree, or have another rank."""
    if max(map(len, several), default=-1) != len(after):
        return None
    padded = [_resized(((),) * (len(after) - len(axes)) + axes, after) for axes in several]
    axes = []
    for choices in zip(*padded, strict=True):
        known = {axis for axis in choices if _letter(axis) != "?"}
        if len(known) > 1:
            return None
        axes.append(known.pop() if known else choices[0])
    return tuple(axes)


def _resized(axes: Axes, after: Sequence[int]) -> Axes:
    """The same axes with other numbers of places: of a pool, a Resize, a Slice, a Concat."""
    return tuple(_places(axis, size) for axis, size in zip(axes, after, strict=True))


def _places(axis: Axis, size: int) -> Axis:
    if math.prod(n for _, n in axis) == size:
        return axis
    if size == 1:
        return ()
    if not axis:
        return _axis("?", size)
    if len(axis) > 1:
        return ((axis, size),)
    ((letter, _),) = axis
    whole = isinstance(letter, tuple) and math.prod(n for _, n in letter) == size
    return letter if whole and isinstance(letter, tuple) else ((letter, size),)


def _regrouped(axes: Axes, after: Sequence[int]) -> Axes | None:
    """The same places in another order of axes: split and joined in raster order."""
    parts = [part for axis in axes for part in axis][::-1]
    if 0 in after or any(n == 0 for _, n in parts):
        return None
    result: list[Axis] = []
    for size in after:
        axis: list[Part] = []
        while size > 1:
            if not parts:
                return None
            letter, n = parts.pop()
            outer = math.gcd(n, size)
            if outer not in (n, size):
                return None
            size //= outer
            _append(axis, (letter, outer))
            if outer < n:
                inner = letter if isinstance(letter, tuple) or letter == "?" else "C"
                parts.append((inner, n // outer))
        result.append(tuple(axis))
    return tuple(result) if not parts else None


def _append(axis: list[Part], part: Part) -> None:
    """Channels behind an axis of channels, of H or of W are the inner places of that one."""
    letter, n = part
    if axis and letter == "C" and axis[-1][0] in ("C", "H", "W"):
        axis[-1] = (axis[-1][0], axis[-1][1] * n)
    else:
        axis.append(part)
