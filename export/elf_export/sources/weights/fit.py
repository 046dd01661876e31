"""Making a file's tensors fit a network: names, kernel layout, colour order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_export.errors import WeightsError

Array = npt.NDArray[Any]
Shapes = Mapping[str, tuple[int, ...]]


def fit_chain(tensors: Mapping[str, Array], shapes: Shapes) -> dict[str, npt.NDArray[np.float32]]:
    """Tensors of a plain chain of convolutions, under the names of `shapes`.

    Where the file uses these names, they decide; otherwise its convolutions are taken in natural order of
    their names, each with the bias from the same place.  Kernels may lie as (O, I, kh, kw) or (kh, kw, I, O).

    Parameters
    ----------
    tensors : by name, in natural order
    shapes : ``NAME.weight`` (O, I, kh, kw) and ``NAME.bias`` (O,), in network order

    Raises
    ------
    WeightsError
        Naming the first tensor that is missing or of another shape.
    """
    if not all(name in tensors for name in shapes):
        tensors = _renamed(tensors, [name for name in shapes if name.endswith(".weight")])
    return {name: shaped(name, tensors.get(name), shape) for name, shape in shapes.items()}


def fit_named(
    tensors: Mapping[str, Array], shapes: Shapes, aliases: Callable[[str], Sequence[str]] = lambda _: ()
) -> dict[str, npt.NDArray[np.float32]]:
    """Tensors by name: the names of `shapes` or their `aliases`, all of them behind one common prefix at most.

    Raises
    ------
    WeightsError
        Naming the first tensor that is missing or of another shape.
    """
    first = next(iter(shapes), "")
    prefixes = ["", *(n.removesuffix(k) for k in [first, *aliases(first)] for n in tensors if n.endswith(k))]

    def found(prefix: str, name: str) -> Array | None:
        return next((tensors[prefix + k] for k in [name, *aliases(name)] if prefix + k in tensors), None)

    best = max(prefixes, key=lambda prefix: sum(found(prefix, name) is not None for name in shapes))
    return {name: shaped(name, found(best, name), shape) for name, shape in shapes.items()}


def _renamed(tensors: Mapping[str, Array], wanted: list[str]) -> dict[str, Array]:
    groups: dict[str, dict[str, Array]] = {}
    for name, value in tensors.items():
        # The last separator parts a layer's name from kernel or bias; Keras 2 repeats the layer's name inside.
        place = max(name.rfind("."), name.rfind("/"))
        group = groups.setdefault(name[:place] if place >= 0 else name, {})
        if value.ndim == 4:
            group["weight"] = value
        elif value.ndim == 1 and "bias" not in group:
            group["bias"] = value
    convs = [group for group in groups.values() if "weight" in group]
    found: dict[str, Array] = {}
    for name, group in zip(wanted, convs, strict=False):
        for role, value in group.items():
            found[name.removesuffix("weight") + role] = value
    return found


def shaped(name: str, value: Array | None, shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    """`value` as contiguous finite float32 of `shape`; a kernel may also lie as (kh, kw, I, O)."""
    if value is None:
        raise WeightsError(f"the weights lack {name} {shape}")
    if value.shape != shape and value.ndim == 4:
        value = value.transpose(3, 2, 0, 1)  # (kh, kw, I, O) -> (O, I, kh, kw)
    if value.shape != shape:
        raise WeightsError(f"{name} should have shape {shape}; the weights have {value.shape}")
    array = np.ascontiguousarray(value, np.float32)
    if not np.isfinite(array).all():
        raise WeightsError(f"{name} has NaN or infinite values")
    return array
