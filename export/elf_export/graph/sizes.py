"""The image sizes that a network takes, and a graph with some of them fixed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import onnx

from .image_input import ImageInput

LEAST = 32  # pixels of height and width from which on a graph is expected to run
USUAL = 512  # pixels


@dataclass(frozen=True)
class Sizes:
    """The sizes that the network takes; 0 where any does.

    Attributes
    ----------
    height, width, batch : int
        What is fixed, 0 where free.
    multiple : int
        Free heights and widths are multiples of it.
    min_size : int
        Smallest free height and width.
    """

    height: int = 0
    width: int = 0
    batch: int = 0
    multiple: int = 1
    min_size: int = LEAST

    def near(self, height: int, width: int) -> tuple[int, int]:
        """The size that the network takes next to a wanted one; an odd multiple stays odd."""
        h, w = (max(round(v / self.multiple), 1) * self.multiple for v in (height, width))
        return self.height or max(h, self.min_size), self.width or max(w, self.min_size)

    @property
    def usual(self) -> int:
        """A free height and width of the order of photographs."""
        return replace(self, height=0, width=0).near(USUAL, USUAL)[0]

    def describe(self) -> str:
        """In words, for the log."""
        if self.height and self.width:
            size = f"{self.width}x{self.height} only"
        elif self.height or self.width:
            size = f"{'height' if self.height else 'width'} {self.height or self.width} only, the other is free"
        else:
            size = "any" if self.multiple == 1 else f"multiples of {self.multiple}"
            size += f" from {self.min_size}x{self.min_size}"
        return size + (f"; {self.batch} image(s) at a time" if self.batch else "")


def with_sizes(model: onnx.ModelProto, image: ImageInput, sizes: Sizes) -> onnx.ModelProto:
    """A copy of `model` whose image has the fixed sizes of `sizes`, and symbols N, H, W elsewhere."""
    result = onnx.ModelProto()
    result.CopyFrom(model)
    fixed = {"N": sizes.batch, "H": sizes.height, "W": sizes.width, "C": image.channels}
    for value in result.graph.input:
        if value.name == image.name:
            del value.type.tensor_type.shape.dim[:]
            for axis in image.layout:
                dim = value.type.tensor_type.shape.dim.add()
                if fixed[axis]:
                    dim.dim_value = fixed[axis]
                else:
                    dim.dim_param = axis
    del result.graph.value_info[:]
    for value in result.graph.output:
        value.type.tensor_type.ClearField("shape")
    return result
