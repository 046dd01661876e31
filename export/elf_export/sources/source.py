"""What any network is to an export, be it a named one or anybody's file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
import numpy.typing as npt
import onnx

from elf_export.checks import Check
from elf_export.checks.projection import Maps
from elf_export.errors import LayerError
from elf_export.graph.image_input import ImageInput
from elf_export.graph.receptive_field import Field
from elf_export.graph.sizes import Sizes
from elf_export.preprocessing import Preprocessing
from elf_export.request import Request
from elf_runtime import DetectionParams, WeightsSpec

from .weights.load import NO_WEIGHTS


class Oracle(Protocol):
    """An independent computation that a graph is held against."""

    def check(self, model: onnx.ModelProto, color: str, params: DetectionParams, sizes: Sizes) -> Check:
        """Hold a saliency graph, whose image is of colour order `color`, against it."""

    def maps(self, model: onnx.ModelProto, layers: Sequence[str], color: str) -> Maps:
        """The maps of `layers` by it; by `model`, the saliency graph, where it has none of its own."""

    def averaging(self, forward: onnx.ModelProto) -> Oracle:
        """That of the same network with average-pooling in place of max-pooling, whose forward graph is `forward`."""

    def describing(self, forward: onnx.ModelProto, image: ImageInput) -> Oracle:
        """One for the maps alone of another forward graph, made of the same network's."""


@dataclass(frozen=True)
class Source:
    """A network ready to be differentiated, and all that an export has to know of it.

    Attributes
    ----------
    request : Request
        With what the source has found out put in.
    name : str
        As the contract calls the network.
    model : onnx.ModelProto
        The forward graph, in float32, of an opset that the rules know, its sizes free where they can be.
    image : ImageInput
    layer : str
        The value F.
    descriptors : names of values
        The network's own layers among those that describe.
    preprocessing : Preprocessing
    fields : mapping
        The geometry of every value that depends on the image.
    sizes : Sizes
        What the forward graph takes.
    period : float
        Pixels after which the sizes that it takes, and those of its maps, repeat themselves.
    weights : WeightsSpec
        Where they come from.
    oracle : Oracle
    detection : DetectionParams
        That the file will carry.
    differentiate : bool
        False: F is the saliency map itself.
    scope : str
        In front of its layers' names where they describe: ``NET:`` of a network that is not the detector's.
    scale : float
        Share of the image's height and width at which it sees the image; its fields are in pixels of the image.
    """

    request: Request
    name: str
    model: onnx.ModelProto
    image: ImageInput
    layer: str
    descriptors: tuple[str, ...]
    preprocessing: Preprocessing
    fields: Mapping[str, Field]
    sizes: Sizes
    period: float
    weights: WeightsSpec
    oracle: Oracle
    detection: DetectionParams
    differentiate: bool = True
    scope: str = ""
    scale: float = 1.0

    @property
    def labels(self) -> dict[str, str]:
        """What the file calls the layers that describe, by their own names."""
        return {layer: self.scope + layer for layer in self.descriptors}


@dataclass(frozen=True)
class Sources:
    """All networks of a file: one that detects, and others, if any, that describe.

    Attributes
    ----------
    detector : Source
    others : tuple of Source
        Of each, `descriptors` are used alone.
    """

    detector: Source
    others: tuple[Source, ...] = ()

    @property
    def request(self) -> Request:
        """The detector's, with the weights that the other networks need to be given."""
        weights = (other.request.weights for other in self.others if other.scope)
        given = next((file for file in weights if file is not None), None)
        return replace(self.detector.request, desc_weights=given)

    @property
    def color(self) -> str:
        """Colour order of the one image that all networks see."""
        colors = {source.preprocessing.color for source in (self.detector, *self.others)}
        return colors.pop() if len(colors) == 1 else "bgr"

    @property
    def sizes(self) -> Sizes:
        """What all forward graphs take.

        Raises
        ------
        LayerError
            If the detector takes one size only, which is too small for another network.
        """
        sizes = self.detector.sizes
        for other in self.others:
            least, fixed = other.sizes.min_size, [size for size in (sizes.height, sizes.width) if size]
            if fixed and min(fixed) < least:
                raise LayerError(
                    f"{other.name} describes images of {least}x{least} pixels and more, and the model takes "
                    f"{sizes.describe()}"
                )
            multiple = math.lcm(sizes.multiple, other.sizes.multiple)
            sizes = replace(sizes, min_size=max(sizes.min_size, least), multiple=multiple)
        return sizes

    @cached_property
    def fields(self) -> dict[str, Field]:
        """The geometry of the layer F, under its name, and of all that describe, under their labels."""
        found = {self.detector.layer: self.detector.fields[self.detector.layer]}
        for source in (self.detector, *self.others):
            found |= {label: source.fields[layer] for layer, label in source.labels.items()}
        return found

    @property
    def scales(self) -> dict[str, float]:
        """Share of the image's size at which each layer that describes sees it."""
        return {label: source.scale for source in (self.detector, *self.others) for label in source.labels.values()}

    @property
    def descriptors(self) -> tuple[str, ...]:
        """The layers that describe, in the order that was asked for: the first is the default."""
        return self.detector.request.desc or ()

    @property
    def weights(self) -> WeightsSpec:
        """Where the weights of all networks come from; those that need none are left out."""
        parts = [self.detector.weights, *(other.weights for other in self.others if other.scope)]
        trained = [part for part in parts if part.source != NO_WEIGHTS] or parts[:1]
        if len(trained) == 1:
            return trained[0]
        columns = zip(*((part.source, part.sha256, part.licence or "not stated") for part in trained), strict=True)
        return WeightsSpec(*map("; ".join, columns))

    def maps(self, model: onnx.ModelProto) -> Maps:
        """The maps of all `descriptors`, by each network's oracle; `model` is the saliency graph with all of them."""
        found_by = [(source.labels, source.oracle.maps(model, source.descriptors, self.color))
                    for source in (self.detector, *self.others) if source.descriptors]  # fmt: skip

        def of_all(pixels: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[np.floating]]:
            return {labels[layer]: value for labels, maps in found_by for layer, value in maps(pixels).items()}

        return of_all
