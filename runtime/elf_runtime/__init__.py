"""ELF keypoints and descriptors from an ONNX graph, without PyTorch.

>>> from elf_runtime import ElfRuntime, match
>>> elf = ElfRuntime()
>>> a, b = elf.detect("a.jpg"), elf.detect("b.jpg")      # doctest: +SKIP
>>> pairs = match(a, b)                                   # doctest: +SKIP
"""

from __future__ import annotations

from . import libraries as libraries  # before all that imports OpenCV or ONNX Runtime
from .contract import DescriptorSpec, InputSpec, ModelContract, WeightsSpec
from .engine import ElfFeature2D, ElfRuntime
from .errors import ContractError, ElfError, ImageError, ModelError, ProviderError, SettingError
from .geometry.estimate import estimate
from .geometry.refine import refine
from .geometry.two_view import TwoView
from .model.ort_format import to_ort
from .params import DetectionParams
from .pictures.explanation import draw_explanation
from .pictures.pair import draw_matches
from .pictures.render import draw_keypoints
from .presets import PRESETS, preset
from .results.features import Features
from .results.global_descriptor import global_descriptor
from .results.matches import Matches
from .results.matching import match
from .results.trace import Level, Trace
from .version import __version__ as __version__

__all__ = [
    "PRESETS",
    "ContractError",
    "DescriptorSpec",
    "DetectionParams",
    "ElfError",
    "ElfFeature2D",
    "ElfRuntime",
    "Features",
    "ImageError",
    "InputSpec",
    "Level",
    "Matches",
    "ModelContract",
    "ModelError",
    "ProviderError",
    "SettingError",
    "Trace",
    "TwoView",
    "WeightsSpec",
    "draw_explanation",
    "draw_keypoints",
    "draw_matches",
    "estimate",
    "global_descriptor",
    "match",
    "preset",
    "refine",
    "to_ort",
]
