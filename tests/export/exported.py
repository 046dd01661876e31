"""What the fixture `vgg` gives."""

from __future__ import annotations

from dataclasses import dataclass

import onnx
import torch


@dataclass(frozen=True)
class Exported:
    """The paper's detector: VGG16's pool2."""

    module: torch.nn.Module
    forward: onnx.ModelProto
    model: onnx.ModelProto
