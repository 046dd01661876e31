"""For 8-bit CPUs: gradients in one piece, interleaved channels last, in which 8-bit convolutions run.

Every convolution behind a pool stays a plain one, and every mask is a step, a complement or a product of such: what an
8-bit graph computes without rounding.
"""

from __future__ import annotations

from collections.abc import Collection

from elf_export.graph.graph import Graph

from . import depthwise, plain
from .common import Common
from .phases import Extent, Phases, can_convolve, convolve
from .site import Site
from .walk import Made


class ChannelsLast(Common):
    """requires, call : as of `Common`.
    ensures : as of `Common`; Between is left, for the pass that rounds.
    """

    by_masks = True

    def __init__(self, graph: Graph, keep: Collection[str] = ()) -> None:
        super().__init__(graph, keep)
        del self.forms["Between"]

    def conv_grad(self, site: Site) -> Made:
        """Of a stride: a convolution for each phase, or one for all of them, which 8 bits are fast for."""
        dy, name, _ = site.node.input
        weight, window, group = site.value(name), plain.conv_window(site), site.attrs.get("group", 1)
        if site.channels is None or not can_convolve(window, weight, group) or window.strides[0] == 1:
            return super().conv_grad(site)
        assert weight is not None
        whole = Phases((self.whole(dy),), site.like, 1, Extent.CEIL)
        return self._joined(site, convolve(site, whole, weight, window, group, site.channels < depthwise.FEW))

    def split(self, site: Site, pieces: tuple[str, ...]) -> Made:
        return self._joined(site, Phases(pieces, site.like))

    def _joined(self, site: Site, part: Phases) -> Made:
        """Phases put together at once; those that are in one piece later, or never."""
        if part.joined:
            return part
        self.parts[site.node.output[0]] = part
        return self.whole(site.node.output[0])
