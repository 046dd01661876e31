"""The contract between exporter and runtime: ``elf.*`` metadata inside the .onnx file.

One class, one writer (`ModelContract.to_metadata`), one reader (`ModelContract.from_metadata`).
An ELF graph takes raw pixels and needs nothing but what stands here to be used from any language:

====================  =================  ==========================================================
tensor                shape              content
====================  =================  ==========================================================
``image``             (N, H, W, 3)       float32, 0..255 (or the `InputSpec.value_range`), BGR by default
``saliency``          (N, H, W)          float32, >= 0: channel mean of abs(F^T dF/dI)
``descriptors_L``     (N, h, w, D)       float32, feature map of layer L, channels last, not normalised
====================  =================  ==========================================================
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, get_type_hints

from .errors import ContractError, SettingError, first_line
from .params import DetectionParams

SCHEMA_VERSION = 1
KEY_PREFIX = "elf."

# What a contract may say at most: more is a damaged file, not a model.
LARGEST_SIDE = 8192  # pixels, and values of a descriptor
LARGEST_IMAGE = 4096 * 4096  # pixels of a fixed size
LARGEST_LEAST = 1024  # pixels, of the smallest side and of a multiple
LARGEST_NUMBER = 1e15


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
class DescriptorSpec:
    """One descriptor map and where its cells lie in the image.

    The centre of cell ``i`` lies at pixel ``offset + i * stride`` (integer = pixel centre), for x and y
    alike: the network's true geometry, from the strides, kernels and pads on the way to the layer.
    `reduction` is None where the map is the layer itself.
    """

    output: str
    layer: str
    dim: int
    stride: float
    offset: float
    reduction: ReductionSpec | None = None

    def check(self) -> None:
        if not 1 <= self.dim <= LARGEST_SIDE or self.stride <= 0:
            raise ValueError(f"descriptor {self.layer!r} has dim {self.dim} and stride {self.stride}")


@dataclass(frozen=True)
class WeightsSpec:
    """Where the trained tensors came from, and a hash over the tensors themselves."""

    source: str = ""
    sha256: str = ""
    licence: str = ""


@dataclass(frozen=True)
class ModelContract:
    """Everything that the runtime must know about a model, and a user may want to.

    Attributes
    ----------
    network, layer : str
        The network, and the layer F whose saliency the graph computes.
    stride : float
        Pixels of the image per cell of F.
    receptive_field : float
        Pixels of the image that a cell of F sees, along each side; 0 where that is not known, or the whole image.
    input : InputSpec
    saliency_output : str
        Name of the (N, H, W) output.
    descriptors : tuple of DescriptorSpec
        The descriptor outputs; the first is the default; empty for a detector-only model.
    detection : DetectionParams
        Settings used where the caller gives none.
    preprocessing : str
        What the graph does to the raw pixels, in words; it is inside the graph.
    precision : str
        "fp32", "fp16", "int8", ...
    parity : mapping
        The exporter's measured errors against its reference (maximum, share of pixels, keypoints).
    cost : mapping
        ``params`` (count) and multiply-adds per image pixel of the saliency and of each descriptor.
    versions : mapping
        Exporter and library versions, and the opset.
    """

    network: str
    layer: str
    stride: float
    receptive_field: float = 0.0
    input: InputSpec = field(default_factory=InputSpec)
    saliency_output: str = "saliency"
    descriptors: tuple[DescriptorSpec, ...] = ()
    detection: DetectionParams = field(default_factory=DetectionParams)
    preprocessing: str = ""
    precision: str = "fp32"
    weights: WeightsSpec = field(default_factory=WeightsSpec)
    parity: Mapping[str, float] = field(default_factory=dict)
    cost: Mapping[str, float] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    command: str = ""  # the elf-export command that makes this file again

    def __repr__(self) -> str:
        described = ", ".join(f"{d.layer} ({d.dim} values)" for d in self.descriptors) or "none"
        return f"ModelContract({self.network} {self.layer}, descriptors {described}, {self.precision})"

    def to_metadata(self) -> dict[str, str]:
        """The contract as ``{key: text}`` for ONNX ``metadata_props``; values are JSON."""
        fields = {"schema": SCHEMA_VERSION, **asdict(self)}
        return {KEY_PREFIX + key: json.dumps(value, sort_keys=True) for key, value in fields.items()}

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str], file: str) -> ModelContract:
        """Read and check the contract of `file`.

        Raises
        ------
        ContractError
            If there is none, it is of another schema, or a key is missing, unreadable or out of range.
            The message names the file, the key, both versions and the command that exports it again.
        """
        key = KEY_PREFIX + "schema"
        if key not in metadata:
            raise ContractError(
                f"{file}: not an ELF model: its metadata has no {key!r}. Any CNN can be made one: "
                f"elf-export --onnx {file} --layer NAME --desc none (elf-export --onnx {file} --list shows the layers)"
            )
        again = metadata.get(KEY_PREFIX + "command", "").strip('"')[:500] or "elf-export --net NETWORK --layer LAYER"
        hint = f"This runtime reads schema {SCHEMA_VERSION}. Export it again: {again}"
        if metadata[key] != str(SCHEMA_VERSION):
            raise ContractError(f"{file}: metadata key {key!r} is {metadata[key][:100]}. {hint}")
        fields = {k[len(KEY_PREFIX) :]: v for k, v in metadata.items() if k.startswith(KEY_PREFIX)}
        del fields["schema"]
        values: dict[str, Any] = {}
        for name, text in fields.items():
            if name not in cls.__dataclass_fields__:
                continue  # a later minor version may say more
            try:
                values[name] = _decode(name, _plain_data(text))
            except (ValueError, TypeError, KeyError, AttributeError, RecursionError, SettingError) as error:
                raise ContractError(
                    f"{file}: metadata key 'elf.{name}' is unreadable: {first_line(error)}. {hint}"
                ) from error
        missing = [name for name in ("network", "layer", "stride", "input", "descriptors") if name not in values]
        if missing:
            raise ContractError(f"{file}: metadata key 'elf.{missing[0]}' is missing. {hint}")
        if values["stride"] == 0:
            raise ContractError(f"{file}: metadata key 'elf.stride' is 0. {hint}")
        return cls(**values)

    def check_tensors(self, inputs: Sequence[Any], outputs: Sequence[Any], file: str) -> None:
        """Hold the contract against the session's tensors (objects with name, type and shape).

        Raises
        ------
        ContractError
            Naming the file, the key and both sides of the disagreement.
        """
        hint = f"Export it again: {self.command[:500] or 'elf-export ...'}"
        if len(inputs) != 1 or inputs[0].name != self.input.name:
            names = [tensor.name for tensor in inputs]
            raise ContractError(f"{file}: 'elf.input' says {self.input.name!r}, the graph takes {names}. {hint}")
        shape = list(inputs[0].shape)
        if inputs[0].type != "tensor(float)" or len(shape) != 4 or shape[3] != self.input.channels:
            raise ContractError(
                f"{file}: 'elf.input' says float32 (N, H, W, {self.input.channels}), "
                f"the graph takes {inputs[0].type} {shape}. {hint}"
            )
        sizes = {"batch": (shape[0], self.input.batch), "height": (shape[1], self.input.height)}
        sizes["width"] = (shape[2], self.input.width)
        for axis, (dim, stated) in sizes.items():
            if isinstance(dim, int) and dim != stated:
                raise ContractError(
                    f"{file}: 'elf.input' says {axis} {stated or 'free'}, the graph takes {dim} only. {hint}"
                )
        by_name = {tensor.name: tensor for tensor in outputs}
        wanted: list[tuple[str, str, int, int | None]] = [("saliency_output", self.saliency_output, 3, None)]
        wanted += [("descriptors", d.output, 4, d.dim) for d in self.descriptors]
        for key, name, rank, dim in wanted:
            tensor = by_name.get(name)
            if tensor is None:
                raise ContractError(
                    f"{file}: 'elf.{key}' says output {name!r}, the graph has {sorted(by_name)}. {hint}"
                )
            shape = list(tensor.shape)
            wrong_dim = len(shape) == rank and dim is not None and isinstance(shape[-1], int) and shape[-1] != dim
            if tensor.type != "tensor(float)" or len(shape) != rank or wrong_dim:
                raise ContractError(
                    f"{file}: 'elf.{key}' says float32 of rank {rank}"
                    + (f" and last dimension {dim}" if dim else "")
                    + f" for output {name!r}, the graph gives {tensor.type} {shape}. {hint}"
                )

    def descriptor(self, layer: str | None = None) -> DescriptorSpec | None:
        """The descriptor of `layer`, by default the first; None in a detector-only model.

        Raises
        ------
        SettingError
            If the model has no such descriptor layer.
        """
        if layer is None:
            return self.descriptors[0] if self.descriptors else None
        for spec in self.descriptors:
            if spec.layer == layer:
                return spec
        known = [spec.layer for spec in self.descriptors] or "none"
        raise SettingError(f"this model has no descriptor layer {layer!r}; it has {known}")


def _decode(name: str, value: Any) -> Any:
    if name == "input":
        spec = InputSpec(**_typed(InputSpec, value))
        spec.check()
        return spec
    if name == "descriptors":
        if not isinstance(value, list):
            raise TypeError(f"expected a list, found {value!r}")
        specs = tuple(_descriptor(item) for item in value)
        for item in specs:
            item.check()
        return specs
    if name == "weights":
        return WeightsSpec(**_typed(WeightsSpec, value))
    if name == "detection":
        return DetectionParams.from_dict(value)
    kind = get_type_hints(ModelContract)[name]
    if kind is float:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value <= LARGEST_SIDE:
            raise ValueError(f"expected a number of pixels from 0 to {LARGEST_SIDE}, found {value!r}")
        return float(value)
    if kind is str and not isinstance(value, str):
        raise TypeError(f"expected text, found {value!r}")
    if kind not in (float, str):
        if not isinstance(value, dict):
            raise TypeError(f"expected an object, found {value!r}")
        wanted: Any = str if name == "versions" else (int, float)
        wrong = [key for key, entry in value.items() if isinstance(entry, bool) or not isinstance(entry, wanted)]
        if wrong:
            raise TypeError(f"{wrong[0]!r} is {value[wrong[0]]!r}")
    return value


def _plain_data(text: str) -> Any:
    """The value of a JSON text, whose numbers are finite and no larger than any that a contract needs."""
    return json.loads(text, parse_int=_integer, parse_float=_real, parse_constant=_real)


def _integer(digits: str) -> int:
    _real(digits)
    return int(digits)


def _real(digits: str) -> float:
    value = float(digits)
    if not abs(value) <= LARGEST_NUMBER:
        raise ValueError(f"a number is {digits[:40]}, and not between -{LARGEST_NUMBER:g} and {LARGEST_NUMBER:g}")
    return value


def _descriptor(value: dict[str, Any]) -> DescriptorSpec:
    stated = value.get("reduction")
    reduction = None if stated is None else ReductionSpec(**_typed(ReductionSpec, stated))
    return DescriptorSpec(**_typed(DescriptorSpec, {**value, "reduction": reduction}))


def _typed(cls: type, value: dict[str, Any]) -> dict[str, Any]:
    """`value` restricted to the fields of `cls`, each of the field's type."""
    known = {k: v for k, v in value.items() if k in cls.__dataclass_fields__}  # type: ignore[attr-defined]
    for key, kind in get_type_hints(cls).items():
        if key in known:
            found = known[key]
            fits = isinstance(found, (int, float) if kind is float else kind)
            if not fits or (kind is float and isinstance(found, bool)):
                raise TypeError(f"{key} should be {kind.__name__}, found {found!r}")
    return known
