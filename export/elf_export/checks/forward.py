"""The maps of a forward graph, by a run of it alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import onnx

from elf_export.graph.image_input import ImageInput
from elf_export.graph.passes import cut
from elf_export.graph.sizes import Sizes
from elf_export.preprocessing import Preprocessing
from elf_runtime import DetectionParams
from elf_runtime.model.session import open_session

from . import Check
from .pictures import preprocess

Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class ForwardMaps:
    """The oracle of a network that describes and does not detect: its forward graph, whose maps are (N, D, h, w)."""

    forward: onnx.ModelProto
    image: ImageInput
    preprocessing: Preprocessing

    def check(self, model: onnx.ModelProto, color: str, params: DetectionParams, sizes: Sizes) -> Check:
        """There is no saliency of it to check."""
        raise NotImplementedError

    def averaging(self, forward: onnx.ModelProto) -> ForwardMaps:
        return replace(self, forward=forward)

    def describing(self, forward: onnx.ModelProto, image: ImageInput) -> ForwardMaps:
        return replace(self, forward=forward, image=image)

    def maps(self, _: onnx.ModelProto, layers: Sequence[str], color: str) -> Callable[[Array], Mapping[str, Array]]:
        """The maps of `layers`, channels last, for raw pixels of colour order `color`."""
        session, _options = open_session(cut(self.forward, layers).SerializeToString())

        def of_layers(pixels: Array) -> dict[str, Array]:
            x = preprocess(pixels, self.preprocessing, color, self.image.layout).astype(np.float32)
            found = session.run(list(layers), {self.image.name: x})
            return {layer: value.transpose(0, 2, 3, 1) for layer, value in zip(layers, found, strict=True)}

        return of_layers
