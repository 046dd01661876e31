"""The kinds of datasets by name: each a function of its own module."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from elf_eval.errors import EvalError
from elf_eval.spec import Spec
from elf_runtime.errors import suggestion

from .colmap import colmap
from .dataset import Dataset
from .derived import rotation, scale, synthetic
from .hpatches import hpatches
from .pair_list import pair_list
from .strecha import strecha
from .webcam import webcam

DATASETS: Mapping[str, Callable[[Spec], Dataset]] = MappingProxyType(
    {
        "hpatches": hpatches,
        "webcam": webcam,
        "rotation": rotation,
        "scale": scale,
        "strecha": strecha,
        "pairs": pair_list,
        "colmap": colmap,
        "synthetic": synthetic,
    }
)


def open_dataset(text: str, incomplete: dict[str, str] | None = None) -> Dataset:
    """The dataset that a text such as ``hpatches:FOLDER?part=v`` names.

    Parameters
    ----------
    incomplete : dict, optional
        Where given, scenes of which something is missing are left out, and this gets their names and what is missing.

    Raises
    ------
    EvalError
        On an unknown kind or option, a missing file, or a folder without a pair.
    """
    spec = Spec.parse(text)
    spec.incomplete = incomplete
    if spec.kind not in DATASETS:
        near = suggestion(spec.kind, DATASETS)
        raise EvalError(f"{text}: unknown kind of dataset {spec.kind!r}; known are {sorted(DATASETS)}{near}")
    dataset = DATASETS[spec.kind](spec)
    spec.finish()
    if not dataset.pairs:
        raise EvalError(f"{text}: no pairs found")
    return dataset
