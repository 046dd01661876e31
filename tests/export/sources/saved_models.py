"""A small model as a file, for what reads models from files."""

from __future__ import annotations

from pathlib import Path

import onnx


def saved(model: onnx.ModelProto, folder: Path) -> Path:
    onnx.save(model, folder / "model.onnx")
    return folder / "model.onnx"
