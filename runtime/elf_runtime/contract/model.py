"""`ModelContract`: everything that the runtime must know about a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from elf_runtime.errors import ContractError, SettingError, suggestion
from elf_runtime.params import DetectionParams

from .metadata import read_metadata, write_metadata
from .specs import CompressionSpec, DescriptorSpec, EndToEndSpec, InputSpec, WeightsSpec
from .tensors import disagreement, disagreement_alone

_LATER = ("scales", "suppression", "oriented", "max_side")  # settings that older files do not state


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
    pooling : str
        "average" where the detector averages in place of the network's max-pooling; "" where it is as it was trained.
    compression : CompressionSpec, optional
        Of the network's convolutions, where they are not as they were trained.
    end_to_end : EndToEndSpec, optional
        Of a file that gives keypoints itself, with the settings `detection`: the form of its graph.
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
    pooling: str = ""
    compression: CompressionSpec | None = None
    end_to_end: EndToEndSpec | None = None
    parity: Mapping[str, float] = field(default_factory=dict)
    cost: Mapping[str, float] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    command: str = ""  # the elf-export command that makes this file again

    def __repr__(self) -> str:
        described = ", ".join(f"{d.layer} ({d.dim} values)" for d in self.descriptors) or "none"
        return f"ModelContract({self.network} {self.layer}, descriptors {described}, {self.precision})"

    def to_metadata(self) -> dict[str, str]:
        """The contract as ``{key: text}`` for ONNX ``metadata_props``; values are JSON.

        Fields that came later are left out where they say nothing: files without them stay as they were.
        """
        values = asdict(self)
        if not self.pooling:
            del values["pooling"]
        for spec in values["descriptors"]:
            if spec["scale"] == 1.0:
                del spec["scale"]
        for name in ("compression", "end_to_end"):
            if getattr(self, name) is None:
                del values[name]
        for name in _LATER:
            if getattr(self.detection, name) == getattr(DetectionParams, name):
                del values["detection"][name]
        return write_metadata(values)

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str], file: str) -> ModelContract:
        """Read and check the contract of `file`.

        Raises
        ------
        ContractError
            If there is none, it is of another schema, or a key is missing, unreadable or out of range.
            The message names the file, the key, both versions and the command that exports it again.
        """
        return cls(**read_metadata(cls, metadata, file))

    def check_tensors(self, inputs: Sequence[Any], outputs: Sequence[Any], file: str) -> None:
        """Hold the contract against the session's tensors (objects with name, type and shape).

        Raises
        ------
        ContractError
            Naming the file, the key and both sides of the disagreement.
        """
        if self.end_to_end is None:
            found = disagreement(self.input, self.saliency_output, self.descriptors, inputs, outputs)
        else:
            found = disagreement_alone(self.end_to_end, self.saliency_output, self.descriptors, inputs, outputs)
        if found:
            raise ContractError(f"{file}: {found}. Export it again: {self.command[:500] or 'elf-export ...'}")

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
        known = [spec.layer for spec in self.descriptors]
        near = suggestion(layer, known)
        raise SettingError(f"this model has no descriptor layer {layer!r}; it has {known or 'none'}{near}")
