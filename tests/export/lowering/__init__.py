"""Tests of the lowerings: each against the gradient in float64."""

import pytest

pytest.importorskip("torch", reason="the export half needs torch")
pytest.importorskip("onnx", reason="the export half needs onnx")
