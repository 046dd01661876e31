"""What the tests of a named network must know of it: a row in tests/export/sources/networks/NAME.py."""

from __future__ import annotations

import runpy
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

FOLDER = Path(__file__).parent / "export" / "sources" / "networks"


@dataclass(frozen=True)
class NetworkRow:
    """Facts that are published, and where the geometry is looked at.

    Attributes
    ----------
    parameters : int, optional
        The published total without the classifier.
    input_size : int
        Height and width of the image that `maps` are for.
    maps : mapping
        Layer -> (C, H, W), as the paper or the original framework states it.
    geometry : sequence of (layer, (height, width))
        Where a cell looks, on an image of this size; its receptive field must fit into it.
    other_layers : sequence of str
        Layers whose saliency is held against float64 autograd, beside the default one.
    weights : str, optional
        A file of the development data with the published weights.
    """

    input_size: int = 0
    maps: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    parameters: int | None = None
    geometry: tuple[tuple[str, tuple[int, int]], ...] = ()
    other_layers: tuple[str, ...] = ()
    weights: str | None = None


def network_rows() -> dict[str, NetworkRow]:
    """All rows, by the network's name."""
    return {path.stem: runpy.run_path(str(path))["ROW"] for path in sorted(FOLDER.glob("*.py"))}
