"""The .onnx reader: what it reads is what the file holds; what is no model ends in ModelError."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest

from elf_runtime import ModelError
from elf_runtime.model.onnx_file import Tensor, read_onnx
from helpers import TINY


def field(number: int, payload: bytes | int) -> bytes:
    """One protobuf field: a varint below 128, or a length (below 128) and bytes."""
    if isinstance(payload, int):
        return bytes([number << 3, payload])
    return bytes([number << 3 | 2, len(payload)]) + payload


OPSET = field(8, field(2, 17))


def test_reads_the_tiny_model() -> None:
    model = read_onnx(TINY)
    assert model.opsets == {"ai.onnx": 17}
    assert model.ir_version == 8
    assert [(t.name, t.dtype, t.dims) for t in model.inputs] == [("image", "float32", ("N", "H", "W", 3))]
    assert [t.name for t in model.outputs] == ["saliency", "descriptors_relu2", "descriptors_pool1"]
    kernels = {t.name: t for t in model.initializers}
    assert kernels["conv2.weight"] == Tensor("conv2.weight", "float32", (8, 8, 3, 3), 576, 2304)
    counts = model.op_counts()
    assert counts["Conv"] >= 3
    assert counts["MaxPool"] == 1
    assert sum(counts.values()) == len(model.nodes)
    assert list(counts.values()) == sorted(counts.values(), reverse=True)
    assert model.metadata["elf.network"] == '"tiny"'


def test_agrees_with_the_onnx_package() -> None:
    onnx = pytest.importorskip("onnx")
    wanted, found = onnx.load(TINY), read_onnx(TINY)
    assert [(n.op_type, n.name, n.domain, tuple(n.input), tuple(n.output)) for n in wanted.graph.node] == [
        (n.op, n.name, n.domain, n.inputs, n.outputs) for n in found.nodes
    ]
    arrays = [onnx.numpy_helper.to_array(t) for t in wanted.graph.initializer]
    assert [(str(a.dtype), a.shape, a.size, a.nbytes) for a in arrays] == [
        (t.dtype, t.dims, t.size, t.nbytes) for t in found.initializers
    ]


def test_counts_what_subgraphs_hold() -> None:
    inner = field(1, field(4, b"Relu")) + field(5, field(1, 5) + field(2, 1) + field(8, b"w"))
    outer = field(4, b"If") + field(5, field(1, b"then_branch") + field(6, inner))
    model = read_onnx(field(1, 8) + field(7, field(1, outer)) + OPSET)
    assert model.op_counts() == {"If": 1, "Relu": 1}
    assert model.initializers == (Tensor("w", "float32", (5,), 5, 20),)


def test_every_truncation_is_a_model_error_or_a_shorter_model() -> None:
    data = TINY.read_bytes()
    whole = read_onnx(data)
    readable = []
    for length in range(len(data)):
        try:
            found = read_onnx(data[:length])
        except ModelError:
            continue
        readable.append(length)
        assert found.nodes == whole.nodes
    # A cut between two whole fields of the outermost message can't be seen: graph and opset are there, and
    # only metadata behind them is gone (the contract's own check sees that).
    assert len(readable) <= len(whole.metadata) + 1


@pytest.mark.parametrize("seed", range(5))
def test_damaged_models_and_noise_raise_nothing_else(seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = np.frombuffer(TINY.read_bytes(), np.uint8)
    for _ in range(60):
        damaged = data.copy()
        places = rng.integers(0, len(data), rng.integers(1, 20))
        damaged[places] = rng.integers(0, 256, len(places))
        for candidate in (damaged.tobytes(), rng.bytes(int(rng.integers(0, 400)))):
            with contextlib.suppress(ModelError):
                read_onnx(candidate)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "it is empty"),
        (b"just some text\n", "not an ONNX model"),
        (b"\x89PNG\r\n\x1a\n" + bytes(20), "not an ONNX model"),
        (b"\x08" + b"\xff" * 11, "more than ten bytes"),
        (b"\x08", "ends inside a number"),
        (field(1, 8) + b"\x3a\x7f", "needs 127 bytes, 0 are left"),
        (field(1, 8) + field(7, 5) + OPSET, "in place of a message"),
        (field(1, 8) + field(7, field(1, field(4, b"\xff"))) + OPSET, "not text"),
    ],
)
def test_says_why_it_is_no_model(data: bytes, reason: str) -> None:
    with pytest.raises(ModelError, match=reason):
        read_onnx(data)


def test_graphs_nested_without_end_are_refused() -> None:
    def wrapped(payload: bytes, number: int) -> bytes:
        length, size = b"", len(payload)
        while size >= 128:
            length, size = length + bytes([size & 127 | 128]), size >> 7
        return bytes([number << 3 | 2]) + length + bytes([size]) + payload

    graph = b""
    for _ in range(100):
        graph = wrapped(wrapped(wrapped(graph, 6), 5), 1)
    with pytest.raises(ModelError, match="nested"):
        read_onnx(field(1, 8) + wrapped(graph, 7) + OPSET)


def test_a_missing_file_is_a_model_error(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="No such file"):
        read_onnx(tmp_path / "absent.onnx")
