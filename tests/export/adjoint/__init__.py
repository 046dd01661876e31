"""Tests of the adjoint: every rule against three oracles, see `oracles`."""

import pytest

pytest.importorskip("torch", reason="the export half needs torch")
pytest.importorskip("onnx", reason="the export half needs onnx")
