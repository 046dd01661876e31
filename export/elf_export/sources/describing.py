"""Layers of other networks among those that describe: ``--desc NET:LAYER``."""

from __future__ import annotations

from collections.abc import Sequence

import onnx

from elf_export.errors import ExportError
from elf_export.request import Request

from .networks import get_network, network_names


def names_another_network(word: str, model: onnx.ModelProto) -> bool:
    """Whether ``NET:LAYER`` means a named network's layer: a value of the model's own may be called so too."""
    network = word.rpartition(":")[0]
    return network in network_names() and not any(word in node.output for node in model.graph.node)


def check_others(request: Request, labels: Sequence[str]) -> None:
    """Raise ExportError unless each of `labels` is ``NET:LAYER`` of a named network, if weights for one are given."""
    for label in labels:
        network, _, layer = label.rpartition(":")
        get_network(network).check_layers([layer])
    if request.desc_weights is not None and not labels:
        raise ExportError(f"--desc-weights {request.desc_weights}: no other network describes (--desc NET:LAYER)")
