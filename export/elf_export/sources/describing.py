"""Layers of other networks among those that describe: ``--desc NET:LAYER``."""

from __future__ import annotations

from collections.abc import Sequence

import onnx

from elf_export.errors import ExportError
from elf_export.request import Request

from .networks import get_network, network_names


def names_another_network(word: str, model: onnx.ModelProto) -> bool:
    """Whether ``NET:LAYER`` means a named network's layer: a layer of the model's own may be called so, or end so."""
    own = (name for node in model.graph.node for name in (node.name, *node.output))
    return word.rpartition(":")[0] in network_names() and not any(name.endswith(word) for name in own)


def check_others(request: Request, labels: Sequence[str]) -> None:
    """Raise ExportError unless each of `labels` is a named network's layer, and weights that are given are for one."""
    for label in labels:
        network, _, layer = label.rpartition(":")
        get_network(network).check_layers([layer])
    if request.desc_weights is not None and not labels:
        raise ExportError(f"--desc-weights {request.desc_weights}: no other network describes (--desc NET:LAYER)")
    networks = sorted({label.rpartition(":")[0] for label in labels})
    if request.desc_weights is not None and len(networks) > 1:
        raise ExportError(
            f"--desc-weights {request.desc_weights} is of one network, and {' and '.join(networks)} describe; take one"
        )
