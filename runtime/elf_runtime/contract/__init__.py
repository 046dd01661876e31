"""The contract between exporter and runtime: ``elf.*`` metadata inside the .onnx file.

One class, `ModelContract`, which writes and reads it.  An ELF graph takes raw pixels and needs nothing but what stands
here to be used from any language:

====================  =================  ==========================================================
tensor                shape              content
====================  =================  ==========================================================
``image``             (N, H, W, 3)       float32, 0..255 (or the `InputSpec.value_range`), BGR by default
``saliency``          (N, H, W)          float32, >= 0: channel mean of abs(F^T dF/dI)
``descriptors_L``     (N, h, w, D)       float32, feature map of layer L, channels last, not normalised
====================  =================  ==========================================================

May import the settings, `plain` and errors.
"""

from __future__ import annotations

from .metadata import SCHEMA_VERSION
from .model import ModelContract
from .specs import CompressionSpec, DescriptorSpec, EndToEndSpec, InputSpec, ReductionSpec, WeightsSpec

__all__ = [
    "SCHEMA_VERSION",
    "CompressionSpec",
    "DescriptorSpec",
    "EndToEndSpec",
    "InputSpec",
    "ModelContract",
    "ReductionSpec",
    "WeightsSpec",
]
