"""Making a Keras file's tensors fit a network with batch normalisations and separable convolutions.

Keras 2 files call a layer by its name, and number the layers that got none; Keras 3 archives number all of
them, each kind apart, in the order of creation.  Roles are names (``kernel``, ``gamma`` ...) or numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from .fit import Array, Shapes, shaped

# Role in our tables -> what the last component of a Keras name holds, by name and by number.
_NORM = {
    "weight": ("gamma", "0"),
    "bias": ("beta", "1"),
    "running_mean": ("mean", "2"),
    "running_var": ("variance", "3"),
}

Layer = dict[str, Array]


def fit_keras(tensors: Mapping[str, Array], shapes: Shapes, order: Sequence[str]) -> dict[str, npt.NDArray[np.float32]]:
    """Tensors under the names of `shapes`.

    Parameters
    ----------
    tensors : by name, in natural order
    shapes : ``LAYER.weight`` of convolutions, ``LAYER.depthwise.weight`` and ``LAYER.pointwise.weight`` of
        separable ones, ``LAYER.weight``, ``.bias``, ``.running_mean`` and ``.running_var`` of normalisations
    order : names of the parts in the order in which Keras creates the layers

    Raises
    ------
    WeightsError
        Naming the first tensor that is missing or of another shape.
    """
    if all(name in tensors for name in shapes):
        return {name: shaped(name, tensors[name], shape) for name, shape in shapes.items()}
    groups = _groups(tensors)
    wanted = list(dict.fromkeys(_layer(part) for part in order))
    named = {name: groups[name] for name in wanted if name in groups}
    kinds: dict[str, list[Layer]] = {}
    for name, group in groups.items():
        if name not in named:
            kinds.setdefault(_kind(group), []).append(group)
    for name in wanted:
        parts = [part for part in order if _layer(part) == name]
        kind = "separable" if len(parts) > 1 else "norm" if name.endswith("_bn") else "conv"
        if name not in named and kinds.get(kind):
            named[name] = kinds[kind].pop(0)
    return {name: shaped(name, _find(named, name), shape) for name, shape in shapes.items()}


def _layer(part: str) -> str:
    return part.partition(".")[0]


def _groups(tensors: Mapping[str, Array]) -> dict[str, Layer]:
    """Layer name -> its tensors by the last component of their names.

    Keras 2 repeats the layer inside itself (``conv/conv/kernel:0``), Keras 3 has ``PATH/conv/vars/0``.  A
    classifier's optimizer keeps copies of shapes that are none of the network's.
    """
    groups: dict[str, Layer] = {}
    for name, value in tensors.items():
        *folders, role = name.split("/")
        path = [folder for folder in folders if folder != "vars"]
        if path and path[0] != "optimizer":
            groups.setdefault(path[-1], {})[role] = value
    return groups


def _kind(group: Layer) -> str:
    ranks = sorted(value.ndim for value in group.values())
    if ranks == [1, 1, 1, 1]:
        return "norm"
    return {1: "conv", 2: "separable"}.get(ranks.count(4), "other")


def _find(named: Mapping[str, Layer], name: str) -> Array | None:
    """The tensor that we call `name`; depthwise kernels (kh, kw, I, 1) come as (kh, kw, 1, I)."""
    layer, _, role = name.partition(".")
    group = named.get(layer, {})
    if role in _NORM and len(group) >= 4:
        word, number = _NORM[role]
        return next((v for k, v in group.items() if k == number or word in k), None)
    kernels = [value for value in group.values() if value.ndim == 4]
    if role == "depthwise.weight":
        found = next((k for k in kernels if k.shape[3] == 1 and k.shape[0] > 1), None)
        return None if found is None else found.swapaxes(2, 3)
    if role == "pointwise.weight":
        return next((k for k in kernels if k.shape[:2] == (1, 1)), None)
    return kernels[0] if kernels else None
