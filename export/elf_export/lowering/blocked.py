"""For float CPUs: in the blocked layout in which ONNX Runtime convolves, gradients in phases as long as that lasts."""

from __future__ import annotations

import math

import onnx

from elf_export.dialect.emit import step
from elf_export.graph.windows import Window

from . import depthwise, plain
from .common import Common
from .phases import Extent, Phases, can_convolve, convolve, extent_of, masked, overhang
from .site import Site, channels_of
from .walk import Made

FARTHEST = 4  # pixels from one window to the next; putting more phases together takes longer


class Blocked(Common):
    """requires, call, ensures : as of `Common`.

    The gradient of a 2x2 pool is four phases, which pass through ReLUs and convolutions of stride 1; it is put together
    only where something wants it whole, at the latest at the image, where it has three channels.
    """

    def in_layout(self, site: Site, dy: str) -> str:
        """Back into the blocked layout at once what was put together outside it."""
        return depthwise.convolve(site, dy, [[1]], [1, 1], "dy_blocked") if dy in self.interleaved else dy

    def conv_grad(self, site: Site) -> Made:
        dy, name, _ = site.node.input
        weight, window, group = site.value(name), plain.conv_window(site), site.attrs.get("group", 1)
        if site.channels is not None and can_convolve(window, weight, group):
            assert weight is not None
            part, few = self.parts.get(dy), 4 * site.known_channels <= depthwise.FEW
            if part is not None and self._stays(part, window, group):
                return convolve(site, part, weight, window, group, few)
            if window.strides[0] > 1 and self._gains(window, group, few):
                return convolve(site, Phases((self.whole(dy),), site.like, 1, Extent.CEIL), weight, window, group, few)
        return super().conv_grad(site)

    def _stays(self, part: Phases, window: Window, group: int) -> bool:
        """Whether phases pass through a convolution: a dense one of stride 1 that keeps the size."""
        assert window.begin is not None, "checked by can_convolve"
        sides = zip(window.begin, window.end, window.kernel, strict=True)
        same_size = all(begin + end == k - 1 for begin, end, k in sides)
        return part.clean and not part.joined and window.strides == (1, 1) and same_size and group == 1

    def _gains(self, window: Window, group: int, few: bool) -> bool:
        """Whether a strided convolution's phases are faster than a ConvTranspose: of few channels, or depthwise.

        ONNX Runtime's ConvTranspose multiplies out all windows first and adds them up then, outside the layout.
        """
        assert window.begin is not None, "checked by can_convolve"
        if any(over < 0 for over in overhang(window)):
            return False  # windows that see none of the image
        if group > 1:
            # Every phase has a tap.
            return window.strides == (2, 2) and min(window.kernel) > 1 and extent_of(window) is not None
        return few and window.strides[0] <= FARTHEST and _waste(window) <= 2

    def between(self, site: Site) -> Made:
        _, high, y = site.node.input
        bound = site.value(high) if high else None
        below = ""
        if bound is not None and site.channels is not None:  # a difference, which Sub takes outside the layout
            below = depthwise.convolve(site, y, [[-1]], [1, 1], "below_high", bias=float(bound))
        elif high:
            below = site.op("Sub", high, y, role="below_high")
        room = plain.room(site, below)
        self.rooms[room] = y
        return step(site, room, "inside")

    def masks(self, node: onnx.NodeProto, grad: str, v: str) -> bool:
        part, like = self.parts.get(grad), self.rooms.get(v, v)
        if part is None or part.joined or channels_of(self.graph, like) is None:
            return False
        with self.graph.replace_node(node):
            self.parts[node.output[0]] = masked(Site(self.graph, node, like), part, v)
        return True


def _waste(window: Window) -> float:
    """Multiplications by the one kernel of all phases, for each that the layer has."""
    stride = window.strides[0]
    assert window.begin is not None, "checked by can_convolve"
    shifts = [len({(a + p - t) // stride for a in range(stride) for t in range(k) if (a + p - t) % stride == 0} | {0})
              for k, p in zip(window.kernel, window.begin, strict=True)]  # fmt: skip
    return stride**2 * math.prod(shifts) / math.prod(window.kernel)
