"""`--compress`: the networks of an export with convolutions in low rank."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from elf_export.calibration import CalibrationSet
from elf_export.checks.differences import Differences
from elf_export.checks.pictures import preprocess
from elf_export.contract import input_spec
from elf_export.errors import LayerError
from elf_export.graph.graph import Graph
from elf_export.graph.passes import cut, factor_convs, fold_batchnorm, fold_constants
from elf_export.request import Log
from elf_runtime.contract import CompressionSpec

from .convolutions import Convolution, Samples, convolutions, named, responses
from .gradients import response_gradients
from .low_rank import approximate, principal, spectrum
from .ranks import Candidate, Compression, of_energy, of_ratio

if TYPE_CHECKING:
    from elf_export.sources.source import Source, Sources

Array = npt.NDArray[np.float32]


def compress(
    sources: Sources, compression: Compression | None, images: CalibrationSet, log: Log = lambda _: None
) -> tuple[Sources, CompressionSpec | None]:
    """The networks with convolutions in low rank, and what the contract says of it; as they are without `compression`.

    Their adjoints, checks and other precisions are then those of the compressed networks: a detector is held against
    central differences of its compressed forward pass, as its framework knows the whole one only.

    Parameters
    ----------
    images : CalibrationSet
        What to fit to.

    Raises
    ------
    ExportError
        No convolution to compress, an unknown one, a ratio that is out of reach, or responses that are not finite.
    """
    if compression is None:
        return sources, None
    networks = [_Network(source, sources, images, index) for index, source in enumerate(_all(sources))]
    convs = {name: (network, conv) for network in networks for name, conv in network.by_name.items()}
    if not convs:
        raise LayerError("--compress: no convolution of the network takes less arithmetic in low rank")
    ranks = _chosen(compression, networks)
    for name, rank in ranks.items():
        network, conv = convs[name]
        if rank * conv.per_rank >= conv.per_cell:
            most = -(-conv.per_cell // conv.per_rank) - 1
            raise LayerError(f"--compress {name}={rank} saves no arithmetic; at most {most} of its channels do")
    for network in networks:
        network.compress(ranks, log)
    spent, whole = (sum(n.multiply_adds(chosen) for n in networks) for chosen in (ranks, {}))
    log(f"compressed to {spent / whole:.1%} of the multiply-adds of the {len(convs)} convolutions that can be")
    detector, *others = (network.compressed for network in networks)
    spec = CompressionSpec(str(compression), ranks, spent / whole, images.name, images.sha256)
    return replace(sources, detector=detector, others=tuple(others)), spec


def _all(sources: Sources) -> Sequence[Source]:
    return (sources.detector, *sources.others)


def _chosen(compression: Compression, networks: Sequence[_Network]) -> dict[str, int]:
    """Name -> rank, in the order of the networks and their convolutions."""
    if compression.ranks:
        found = dict(_resolved(networks, wanted, rank) for wanted, rank in compression.ranks.items())
    else:
        candidates = {name: c for network in networks for name, c in network.candidates.items()}
        if compression.energy is not None:
            found = of_energy(candidates, compression.energy)
        else:
            assert compression.ratio is not None
            found = of_ratio(candidates, compression.ratio)
    order = [name for network in networks for name in network.by_name]
    return {name: found[name] for name in order if name in found}


def _resolved(networks: Sequence[_Network], wanted: str, rank: int) -> tuple[str, int]:
    for network in networks[1:]:
        if wanted.startswith(network.prefix):
            conv = named(network.found, network.graph, wanted.removeprefix(network.prefix))
            return network.prefix + conv.name, rank
    return named(networks[0].found, networks[0].graph, wanted).name, rank


class _Network:
    """A source's forward graph while it is compressed; convolutions of another network are called NET:NAME."""

    def __init__(self, source: Source, sources: Sources, images: CalibrationSet, index: int) -> None:
        self.source, self.images, self.index = source, images, index
        self.color, self.scale = sources.color, sources.detector.detection.working_scales[0]
        self.keep = list(dict.fromkeys([*([source.layer] if index == 0 else []), *source.descriptors]))
        self.prefix = f"{source.name}:" if index else ""
        self.graph = fold_batchnorm(fold_constants(Graph(cut(source.model, self.keep), copy=False)), keep=self.keep)
        # A layer whose channels are projected has its low rank by that.
        projected = source.descriptors if sources.request.reduction is not None else ()
        self.found = [conv for conv in convolutions(self.graph, self.keep) if conv.result not in projected]
        self.by_name = {self.prefix + conv.name: conv for conv in self.found}
        self.changed = False

    @cached_property
    def whole(self) -> Samples:
        """Responses of the network before anything of it is compressed."""
        return self._responses([conv.result for conv in self.found])

    @cached_property
    def passes(self) -> Mapping[str, int]:
        """Result -> how often its convolution is computed: 2 where the gradient goes back through it, else 1."""
        differentiated = self.index == 0 and self.source.differentiate
        on_the_way = self.graph.needed([self.source.layer]) if differentiated else set()
        return {conv.result: 1 + (conv.result in on_the_way) for conv in self.found}

    @cached_property
    def candidates(self) -> dict[str, Candidate]:
        return {
            name: Candidate(
                spectrum(self.whole.rows[conv.result]),
                self._cells(conv) * conv.per_cell,
                self._cells(conv) * conv.per_rank,
            )
            for name, conv in self.by_name.items()
        }

    def compress(self, ranks: Mapping[str, int], log: Log) -> None:
        """Convolution by convolution, in the graph's order.

        One that the gradient goes back through is projected, so that its adjoint is the projection of the whole one's;
        another is fitted behind those before it as they are by then.
        """
        gradients = {
            conv.result: response_gradients(self.graph, conv, self.source.layer, self.source.image.name, self._pictures)
            for name, conv in self.by_name.items()
            if name in ranks and self.passes[conv.result] > 1
        }
        for name, conv in self.by_name.items():
            if name not in ranks:
                continue
            wanted = given = self.whole.rows[conv.result]
            if conv.result in gradients:
                low = principal(wanted, ranks[name], gradients[conv.result])
            else:
                given = self._responses([conv.result]).rows[conv.result] if self.changed else wanted
                low = approximate(wanted, given, ranks[name])
            lost = np.square(low(given) - wanted).sum() / np.square(wanted - wanted.mean(axis=0)).sum()
            log(f"{name}: {ranks[name]} of {conv.channels} channels in the middle, {1 - lost:.2%} of its variance")
            factor_convs(self.graph, {conv.result: low.kernels(conv.kernel, conv.bias)})
            self.changed = True

    def multiply_adds(self, ranks: Mapping[str, int]) -> float:
        """Of all convolutions that can be compressed, over an image; backward pass included."""
        return sum(
            self._cells(conv) * (conv.per_rank * ranks[name] if name in ranks else conv.per_cell)
            for name, conv in self.by_name.items()
        )

    @property
    def compressed(self) -> Source:
        """The source as it is by now; its own oracle knows the whole network only, so it gets another."""
        if not self.changed:
            return self.source
        source, model = self.source, self.graph.model
        del model.graph.value_info[:]
        oracle = (
            source.oracle.describing(model, source.image)
            if self.index
            else Differences(model, source.layer, source.image, source.preprocessing)
        )
        return replace(source, model=model, oracle=oracle)

    def _cells(self, conv: Convolution) -> float:
        return self.whole.cells[conv.result] * self.passes[conv.result]

    def _responses(self, results: Sequence[str]) -> Samples:
        return responses(self.graph, results, self.source.image.name, self._pictures, len(self.images))

    def _pictures(self) -> Iterator[Array]:
        """The calibration images as the network's own input."""
        source = self.source
        for pixels in self.images.batches(input_spec(self.color, source.sizes), self.scale):
            yield preprocess(pixels, source.preprocessing, self.color, source.image.layout).astype(np.float32)
