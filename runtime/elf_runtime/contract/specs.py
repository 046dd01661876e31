"""The parts of a contract: what the graph takes, its descriptor maps, and the origin of its weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

# What a contract may say at most: more is a damaged file, not a model.
LARGEST_SIDE = 8192  # pixels, and values of a descriptor
LARGEST_IMAGE = 4096 * 4096  # pixels of a fixed size
LARGEST_LEAST = 1024  # pixels, of the smallest side and of a multiple


@dataclass(frozen=True)
class InputSpec:
    """What the graph expects to be fed.

    Attributes
    ----------
    min_size : int
        Smallest H and W, in pixels.
    height, width, batch : int
        The one size that the graph takes, 0 where it takes any.
    multiple : int
        Free heights and widths must be multiples of it.
    """

    name: str = "image"
    color: str = "bgr"  # "bgr", "rgb" or "gray"
    layout: str = "NHWC"
    dtype: str = "float32"
    value_range: float = 255.0  # the value that a saturated pixel must have
    channels: int = 3
    min_size: int = 32
    height: int = 0
    width: int = 0
    batch: int = 0
    multiple: int = 1

    def check(self) -> None:
        """Raise ValueError on values that no contract may have."""
        if self.color not in ("bgr", "rgb", "gray"):
            raise ValueError(f"color {self.color!r} is not one of bgr, rgb, gray")
        if self.layout != "NHWC" or self.dtype != "float32":
            raise ValueError(f"layout {self.layout!r} with dtype {self.dtype!r}; only NHWC float32 is defined")
        if self.channels != (1 if self.color == "gray" else 3):
            raise ValueError(f"{self.channels} channels do not fit color {self.color!r}")
        sizes = min(self.height, self.width) >= 0 and max(self.height, self.width) <= LARGEST_SIDE
        steps = min(self.min_size, self.multiple) >= 1 and max(self.min_size, self.multiple) <= LARGEST_LEAST
        if not (sizes and steps and self.height * self.width <= LARGEST_IMAGE and self.batch in (0, 1)):
            raise ValueError(
                f"height {self.height}, width {self.width}, min_size {self.min_size}, batch {self.batch}, "
                f"multiple {self.multiple}; sizes are 0 where free, at most {LARGEST_SIDE} and {LARGEST_IMAGE:,} "
                f"pixels; the batch is 0 or 1, min_size and multiple are 1 to {LARGEST_LEAST}"
            )
        if self.value_range <= 0:
            raise ValueError(f"value_range {self.value_range}; a saturated pixel has a value above 0")

    @property
    def is_fixed(self) -> bool:
        """Whether the image must be resized to one height or width, so that no scale can be chosen."""
        return bool(self.height or self.width)

    def size_for(self, height: int, width: int, scale: float) -> tuple[int, int]:
        """The size (h, w) that the graph is fed for an image of (height, width) at a working scale.

        A fixed size is taken as it is; where only one side is fixed, the other keeps the image's proportions.
        """
        if self.height and self.width:
            return self.height, self.width
        if self.height or self.width:
            scale = self.height / height if self.height else self.width / width
        h, w = (self._allowed(size * scale) for size in (height, width))
        return self.height or h, self.width or w

    def _allowed(self, size: float) -> int:
        if self.multiple == 1:
            return max(1, round(size))
        return max(round(size / self.multiple), -(-self.min_size // self.multiple)) * self.multiple


@dataclass(frozen=True)
class ReductionSpec:
    """How a layer's channels became a descriptor of fewer values; the graph does it, this is a record.

    Attributes
    ----------
    method : str
        "pca" or "channels".
    source_dim : int
        Channels of the layer.
    whiten : float
        Principal components were divided by their variance to the power of whiten / 2.
    kept : float
        Share of the channels' variance over the calibration set that is left, before whitening.
    calibration, sha256 : str
        The images that it was fitted to, and a hash over their files.
    """

    method: str = ""
    source_dim: int = 0
    whiten: float = 0.0
    kept: float = 1.0
    calibration: str = ""
    sha256: str = ""


@dataclass(frozen=True)
class CompressionSpec:
    """How convolutions became two of fewer multiply-adds each; the graph has them, this is a record.

    Attributes
    ----------
    wanted : str
        What was asked for: a ratio, an energy, or ranks.
    ranks : mapping
        Name of a convolution -> channels between its two parts.
    multiply_adds : float
        Share that is left of those of all convolutions that could be compressed.
    calibration, sha256 : str
        The images that it was fitted to, and a hash over their files.
    """

    wanted: str = ""
    ranks: Mapping[str, int] = field(default_factory=dict)
    multiply_adds: float = 1.0
    calibration: str = ""
    sha256: str = ""


@dataclass(frozen=True)
class DescriptorSpec:
    """One descriptor map and where its cells lie in the image.

    The centre of cell ``i`` lies at pixel ``offset + i * stride`` (integer = pixel centre), for x and y
    alike: the network's true geometry, from the strides, kernels and pads on the way to the layer.
    `reduction` is None where the map is the layer itself.  `scale` is a record: the share of the image's height and
    width at which the layer sees it, by a resizing in the graph, which stride and offset know of.
    """

    output: str
    layer: str
    dim: int
    stride: float
    offset: float
    reduction: ReductionSpec | None = None
    scale: float = 1.0

    def check(self) -> None:
        """Raise ValueError on values that no contract may have."""
        if not 1 <= self.dim <= LARGEST_SIDE or self.stride <= 0:
            raise ValueError(f"descriptor {self.layer!r} has dim {self.dim} and stride {self.stride}")
        if not self.scale > 0:
            raise ValueError(f"descriptor {self.layer!r} sees the image at {self.scale} of its size")


@dataclass(frozen=True)
class EndToEndSpec:
    """The tensors of a graph that gives keypoints itself; docs/file-alone.md has them.

    Attributes
    ----------
    pixels : "uint8" or "float32"
        Of the image; floats have the range of the bytes, 0 to 255.
    color : "bgr" or "rgb"
        Order of its channels.
    batch : bool
        Several images of one size at once; outputs are padded.
    rounds : int
        Of the suppression, unrolled; 0 is a Loop.
    saliency : bool
        Whether the saliency map is an output too.
    required : bool
        Whether the inputs beside the image have no defaults.
    opencv : bool
        Whether it is written for cv2.dnn.
    """

    pixels: str = "uint8"
    color: str = "bgr"
    batch: bool = False
    rounds: int = 0
    saliency: bool = False
    required: bool = False
    opencv: bool = False

    def check(self) -> None:
        """Raise ValueError on values that no contract may have."""
        if self.pixels not in ("uint8", "float32") or self.color not in ("bgr", "rgb") or self.rounds < 0:
            raise ValueError(f"pixels {self.pixels!r}, color {self.color!r}, {self.rounds} rounds")


@dataclass(frozen=True)
class WeightsSpec:
    """Where the trained tensors came from, and a hash over the tensors themselves."""

    source: str = ""
    sha256: str = ""
    licence: str = ""
