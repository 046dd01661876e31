"""A model cut down to some outputs computes the same, with less."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from elf_runtime import ModelError
from elf_runtime.model.onnx_file import read_onnx
from elf_runtime.model.protobuf import encoded
from elf_runtime.model.session import open_session
from elf_runtime.model.subgraph import with_outputs
from helpers import TINY


@pytest.mark.parametrize("name", ["saliency", "descriptors_relu2", "descriptors_pool1"])
def test_the_kept_output_is_the_same(name: str) -> None:
    image = np.random.default_rng(0).uniform(0, 255, (1, 48, 64, 3)).astype(np.float32)
    whole, part = (open_session(source, threads=1)[0] for source in (TINY, with_outputs(TINY, [name])))
    assert [output.name for output in part.get_outputs()] == [name]
    np.testing.assert_array_equal(part.run([name], {"image": image})[0], whole.run([name], {"image": image})[0])


def test_what_the_output_does_not_need_is_gone() -> None:
    whole, part = read_onnx(TINY), read_onnx(with_outputs(TINY, ["saliency"]))
    assert "conv2.weight" in {t.name for t in whole.initializers}
    assert "conv2.weight" not in {t.name for t in part.initializers}
    assert part.op_counts()["Conv"] == whole.op_counts()["Conv"] - 1
    assert part.metadata == whole.metadata
    assert part.inputs == whole.inputs


def test_all_outputs_are_the_whole_model() -> None:
    whole = read_onnx(TINY)
    assert read_onnx(with_outputs(TINY, [output.name for output in whole.outputs])) == whole


def test_an_unknown_output_is_named() -> None:
    with pytest.raises(ModelError, match=r"has no output 'depth'.*saliency"):
        with_outputs(TINY, ["depth"])


@pytest.mark.parametrize("data", [b"text\n", TINY.read_bytes()[:5000]])
def test_no_model_is_a_model_error(data: bytes) -> None:
    with pytest.raises(ModelError, match="not an ONNX model"):
        with_outputs(data, ["saliency"])


def test_a_missing_file_is_a_model_error(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"none\.onnx: No such file"):
        with_outputs(tmp_path / "none.onnx", ["saliency"])


@pytest.mark.parametrize("field", [6, 11], ids=["g", "graphs"])
def test_a_node_with_a_graph_of_its_own_is_refused(field: int) -> None:
    """What that graph reads from outside is in no node's inputs."""
    attribute = encoded(1, b"then_branch") + encoded(field, encoded(2, b"inner"))
    node = encoded(1, b"x") + encoded(2, b"y") + encoded(3, b"choice") + encoded(4, b"If") + encoded(5, attribute)
    model = encoded(7, encoded(1, node) + encoded(12, encoded(1, b"y")))
    with pytest.raises(ModelError, match=r"node 'choice' \(If\) has a graph of its own"):
        with_outputs(model, ["y"])
