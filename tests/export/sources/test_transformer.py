"""A vision transformer, by torch's tracing and its dynamo exporter: a correct graph, or a report that helps."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from torch import nn

from elf_export import LayerError, build_gradient, export_onnx
from elf_export.graph.passes import convert_opset
from elf_runtime import ElfRuntime


class TinyViT(nn.Module):
    """Patches of 8 pixels, position embeddings for 48x32 pixels, two blocks."""

    def __init__(self) -> None:
        super().__init__()
        self.patches = nn.Conv2d(3, 32, 8, stride=8)
        self.positions = nn.Parameter(0.1 * torch.randn(1, 24, 32))
        self.blocks = nn.ModuleList(
            nn.TransformerEncoderLayer(32, 4, 64, activation="gelu", batch_first=True, norm_first=True, dropout=0.0)
            for _ in range(2)
        )
        self.norm = nn.LayerNorm(32)
        nn.init.normal_(self.norm.weight)  # with ones, 1/2 |F|^2 is a constant and its gradient rounding

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        tokens = self.patches(x).flatten(2).transpose(1, 2) + self.positions
        for block in self.blocks:
            tokens = block(tokens)
        return self.norm(tokens)


@pytest.fixture(scope="module")
def network() -> nn.Module:
    torch.manual_seed(0)
    return TinyViT().eval()


def exported(network: nn.Module, path: Path, dynamo: bool) -> Path:
    if dynamo:
        pytest.importorskip("onnxscript")
    names = {"input_names": ["image_in"], "output_names": ["tokens"]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network, (torch.randn(1, 3, 32, 48),), str(path), dynamo=dynamo, external_data=False,
            opset_version=18 if dynamo else 17, **names, **({"verbose": False} if dynamo else {}),
        )  # fmt: skip
    return path


@pytest.mark.parametrize("dynamo", [False, True], ids=["tracing", "dynamo"])
def test_the_gradient_of_a_transformer(network: nn.Module, tmp_path: Path, dynamo: bool) -> None:
    path = exported(network, tmp_path / "vit.onnx", dynamo)
    result = export_onnx(path, "tokens", [], tmp_path / "elf.onnx")
    spec = result.contract.input
    assert (spec.height, spec.width) == (32, 48)
    assert result.contract.parity["derivative_median_error"] < 1e-6
    assert ElfRuntime(result.path).saliency(np.eye(96, 128, dtype=np.uint8) * 255).shape == (96, 128)

    import onnxruntime as ort

    x = torch.randn(1, 3, 32, 48, requires_grad=True)
    tokens = network(x)
    (wanted,) = torch.autograd.grad(tokens, x, tokens.detach())
    session = ort.InferenceSession(build_gradient(convert_opset(onnx.load(path)), "tokens").SerializeToString())
    (found,) = session.run(["gradient"], {"image_in": x.detach().numpy()})
    assert np.abs(found - wanted.numpy()).max() < 1e-4 * float(wanted.abs().max())

    with pytest.raises(LayerError, match="'tokens' can't describe keypoints: it is no map"):
        export_onnx(path, "tokens", ["tokens"], tmp_path / "described.onnx")
