"""The operations that gradients are written in, before a target's form of them is chosen.

`ops` says what there is, with an equation each, `reference` computes them in numpy.  The rules of `adjoint` write them,
`lowering` takes them out again.  `emitter` is what both write with; `emit` and `spatial` write standard operations
whose form depends on the opset, and what sliding windows need.  May import `graph`.
"""

from __future__ import annotations

from elf_export.graph.nodes import OWN

from .ops import OPS, Op, is_own

__all__ = ["OPS", "OWN", "Op", "is_own"]
