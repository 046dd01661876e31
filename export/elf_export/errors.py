"""Every error that the exporter raises on purpose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from elf_runtime.errors import ElfError


class ExportError(ElfError):
    """Base of the errors below: catch this one to catch them all."""


class LayerError(ExportError):
    """A layer that the network does not have, or that the image does not reach."""


class WeightsError(ExportError):
    """Weights that can't be found, read, or made to fit the network."""


class VerificationError(ExportError):
    """The exported graph disagrees with its reference."""


@dataclass(frozen=True)
class UnsupportedNode:
    """One node that can't be differentiated."""

    name: str
    op: str
    opset: int
    reason: str


class UnsupportedGraphError(ExportError):
    """Nodes without an adjoint rule; all of them, not the first."""

    has_rows = True

    def __init__(self, nodes: Sequence[UnsupportedNode], supported: Sequence[str]) -> None:
        self.nodes = tuple(nodes)
        rows = "\n".join(f"  {n.op} (opset {n.opset}) at node {n.name!r}: {n.reason}" for n in nodes)
        super().__init__(
            f"{len(nodes)} node(s) between the image and the layer can't be differentiated:\n{rows}\n"
            f"Supported are: {', '.join(supported)}.\n"
            "Choose a layer before the first of them (--list shows the layers), or add a rule with "
            "elf_export.adjoint.adjoint."
        )
