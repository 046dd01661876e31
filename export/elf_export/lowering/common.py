"""What is fast on every processor: masks that are not needed left out, convolutions for transposed ones, late joining.

A max-pool behind a ReLU makes its gradient zero wherever the ReLU's value is not positive.  The ReLU's mask is then
left out, and so is that of the seed, F itself, by a ReLU that makes F.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import onnx

from elf_export.dialect import is_own
from elf_export.dialect.emit import step
from elf_export.dialect.spatial import flipped
from elf_export.graph.graph import Graph, attributes
from elf_export.graph.windows import window_of

from . import depthwise, interleave, plain, pools
from .phases import Phases, all_phases
from .site import Site
from .walk import Lowering, Made


class Common(Lowering):
    """What the targets that want speed have in common; which windows go which way is theirs to say.

    requires, call : as of `Lowering`; maps have their channels first.
    ensures : as of `Lowering`; gradients in phases that are side by side in one piece stay so to the mean over the
        channels.
    """

    by_masks = False  # 2x2 max-pools; see `pools.split`

    def __init__(self, graph: Graph, keep: Collection[str] = ()) -> None:
        super().__init__(graph, keep)
        self.unless: dict[str, str] = {}  # a gradient -> a value wherever which is not positive the gradient is zero
        self.rooms: dict[str, str] = {}  # what a Between's step is taken of -> the value between the bounds

    # -- windows -------------------------------------------------------------------------------------------------

    def max_pool_grad(self, site: Site) -> Made:
        dy, y, x = site.node.input
        window, rectified = window_of(site.graph, site.node, site.attrs["kernel_shape"]), self.is_rectified(x)
        split = pools.is_split(site, window)
        if not split and not pools.overlaps(site, window, rectified):
            return super().max_pool_grad(site)
        self.whole(dy)
        masked = dy == y  # the seed
        dy = self.in_layout(site, dy) if split else dy
        if rectified:
            # The places left over are then all positive: the ReLU's own mask has nothing more to do.
            self.unless[site.node.output[0]] = x
            if not masked:
                dy = site.op("Mul", dy, step(site, y, "positive"), role="dy_positive")
        if not split:
            return pools.overlapping(site, dy, window)
        return self.split(site, pools.split(site, dy, self.by_masks))

    def window_sum(self, site: Site) -> Made:
        dy, scale, _ = site.node.input
        value, window = site.value(scale), window_of(site.graph, site.node, site.attrs["kernel_shape"])
        if value is None or not pools.is_split(site, window):
            return super().window_sum(site)
        # A convolution, which stays in the blocked layout, and which 8 bits round before all that moves its values.
        share = depthwise.convolve(site, self.whole(dy), [[value]], [1, 1], "share")
        return self.split(site, (share,) * len(all_phases(2)))

    def in_layout(self, _site: Site, dy: str) -> str:
        """What a 2x2 pool's gradient is split from, in the layout for what follows."""
        return dy

    def split(self, site: Site, pieces: tuple[str, ...]) -> Made:
        """What becomes of the four phases of a 2x2 pool's gradient."""
        return Phases(pieces, site.like)

    def conv_grad(self, site: Site) -> Made:
        """Of stride 1: again a convolution, the kernel flipped and its channels transposed, pads (k - 1) d - p."""
        dy, weight, _ = site.node.input
        window, kernel, group = plain.conv_window(site), site.value(weight), site.attrs.get("group", 1)
        if kernel is None or set(window.strides) != {1} or window.begin is None:
            return super().conv_grad(site)
        spans = zip(window.extent * 2, window.begin + window.end, strict=True)
        pads = [e - 1 - p for e, p in spans]
        if min(pads) < 0:
            return super().conv_grad(site)
        return site.op(
            "Conv", self.whole(dy), site.const(flipped(kernel, group), "weight"), role="dx",
            kernel_shape=list(window.kernel), pads=pads, dilations=list(window.dilations), group=group,
        )  # fmt: skip

    # -- what passes ---------------------------------------------------------------------------------------------

    def passes(self, node: onnx.NodeProto) -> bool:
        if node.op_type == "Mul":
            return self._product(node)
        part = self.parts.get(node.input[0]) if node.input else None
        if part is None or not part.joined:
            return False
        if node.op_type == "Abs":
            site = Site(self.graph, node, part.like)
            with self.graph.replace_node(node):
                pieces = tuple(site.op("Abs", piece, role="abs") for piece in part.pieces)
            self.parts[node.output[0]] = replace(part, pieces=pieces)
            return True
        if node.op_type == "ReduceMean" and self._is_over_channels(node):
            with self.graph.replace_node(node):
                interleave.mean(Site(self.graph, node, part.like), part, node.output[0])
            return True
        return False

    def _is_over_channels(self, node: onnx.NodeProto) -> bool:
        given = attributes(node)
        axes = self.graph.constant(node.input[1]) if len(node.input) > 1 else given.get("axes")
        return axes is not None and list(axes) == [1] and not given.get("keepdims", 1)

    def _product(self, node: onnx.NodeProto) -> bool:
        """A gradient times a step [v > 0]."""
        for grad, mask in (node.input, node.input[::-1]):
            maker = self.graph.producers().get(mask)
            if maker is not None and is_own(maker, "Step"):
                return self._masked(node, grad, maker.input[0])
        return False

    def _masked(self, node: onnx.NodeProto, grad: str, v: str) -> bool:
        output = node.output[0]
        if self.unless.get(grad) != v and not (grad == v and self.is_rectified(v)):
            return self.masks(node, grad, v)
        with self.graph.replace_node(node):
            if grad in self.parts:
                self.parts[output] = self.parts[grad]
            elif output in self.keep:
                self.graph.op("Identity", grad, name=node.name, outputs=[output])
            else:
                self.graph.replace_uses(output, grad)
        return True

    def masks(self, _node: onnx.NodeProto, _grad: str, _v: str) -> bool:
        """Mask the gradient by [v > 0] in phases; False where it is whole, or has to be."""
        return False

    def is_rectified(self, value: str) -> bool:
        """Whether a ReLU makes the value."""
        maker = self.graph.producers().get(value)
        return maker is not None and maker.op_type == "Relu"
