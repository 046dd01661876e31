"""elf-export --onnx: which layer and which input a name stands for, and models whose values have our names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from elf_export import ExportError, LayerError, build_gradient, build_saliency, export_onnx
from elf_export.cli import main
from elf_export.graph.graph import Graph
from elf_export.graph.passes import rename_values
from elf_export.sources.foreign.image_input import find_image_input
from elf_export.sources.foreign.layers import resolve_layer
from elf_export.sources.foreign.prepare import prepare
from elf_runtime import ElfRuntime
from export import small_models as small
from export.sources.saved_models import saved
from helpers import textured


@pytest.mark.parametrize(
    ("wanted", "value"),
    [
        ("relu1", "relu1"),
        ("block/relu1", "relu1"),
        ("ck/relu1", "relu1"),
        ("d/conv2", "conv2"),
        ("to_nchw", "t"),
    ],
)
def test_layers_are_found_by_value_node_or_end(wanted: str, value: str) -> None:
    assert resolve_layer(small.nhwc(), wanted) == value


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ("2", r"'2' is the end of 2 layers' names: 'conv2', 'relu2'; give more"),
        ("relu9", r"no layer 'relu9'; nearest are .*'relu1'"),
        ("CONV1", r"nearest are 'block/conv1', 'conv1'"),
        ("zzzzz", "no name is like it"),
        ("", "empty"),
    ],
)
def test_layers_that_are_not_found(wanted: str, message: str) -> None:
    with pytest.raises(LayerError, match=message):
        resolve_layer(small.nhwc(), wanted)


def two_images() -> onnx.ModelProto:
    result = small.nchw()
    second = helper.make_tensor_value_info("mask", TensorProto.FLOAT, (1, 1, 64, 64))
    result.graph.input.append(second)
    result.graph.node.append(helper.make_node("Mul", ["x", "mask"], ["masked"], name="masked"))
    return result


def test_which_input_is_the_image() -> None:
    with pytest.raises(ExportError, match="several inputs may be the image: x, mask; name it with --input"):
        find_image_input(two_images())
    assert find_image_input(two_images(), "mask").channels == 1
    with pytest.raises(ExportError, match=r"no input 'y'; it has\n  x: float \(1, 3, 64, 64\)"):
        find_image_input(two_images(), "y")
    with pytest.raises(ExportError, match=r"no input looks like an image.*\n  x: float \(1, 7, 64, 64\)"):
        find_image_input(small.nchw((1, 7, 64, 64)))
    free = find_image_input(small.nchw((1, 3, 64, 64)))
    assert (free.layout, free.size) == ("NCHW", (1, 64, 64))
    assert find_image_input(small.nhwc(("a", "b", "c", "d"))).layout == "NHWC"
    with pytest.raises(LayerError, match="needs more inputs than the image: 'mask'"):
        prepare(two_images(), ["masked"], "x")
    with pytest.raises(LayerError, match="'relu2' does not depend on the image 'mask'"):
        prepare(two_images(), ["relu2"], "mask")


OURS = {"image": "x", "saliency": "relu1", "gradient": "pool1", "descriptors_relu2": "conv2"}


@pytest.mark.parametrize("name", OURS)
def test_a_model_may_use_our_names(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """As its image input, its layer or any other value; the layers keep their names for the user."""
    path = saved(rename_values(Graph(small.nchw()), {OURS[name]: name}).model, tmp_path)
    layer = "pool1" if name == "image" else name
    assert main(["--onnx", str(path), "--list"]) == 0
    assert layer in capsys.readouterr().out
    exports = (layer, ["relu2", layer]), ("relu2", [layer])
    for detector, descriptors in exports:
        found = export_onnx(path, detector, descriptors, tmp_path / "elf.onnx", force=True)
        assert found.contract.layer == detector
        assert [d.layer for d in found.contract.descriptors] == descriptors
        elf = ElfRuntime(found.path)
        plain = export_onnx(
            saved(small.nchw(), tmp_path), OURS[name] if detector == name else detector, [], tmp_path / "plain.onnx",
            force=True,
        )  # fmt: skip
        saved(rename_values(Graph(small.nchw()), {OURS[name]: name}).model, tmp_path)
        image = textured(48, 64)
        assert np.allclose(elf.saliency(image), ElfRuntime(plain.path).saliency(image), atol=1e-6)


@pytest.mark.parametrize("name", ["image", "saliency", "gradient", "descriptors_pool1"])
def test_the_library_s_functions_take_our_names_too(name: str) -> None:
    """For the image, which is then called otherwise where an output has its name, and for F."""
    import onnxruntime as ort

    pixels = np.random.default_rng(0).standard_normal((1, 3, 64, 64)).astype(np.float32)

    def outputs(model: onnx.ModelProto) -> list[np.ndarray]:
        session = ort.InferenceSession(model.SerializeToString())
        return list(session.run(None, {session.get_inputs()[0].name: pixels}))

    for renamed in ("x", "relu2"):
        model = rename_values(Graph(small.nchw()), {renamed: name}).model
        layer = name if renamed == "relu2" else "relu2"
        for build, extra in ((build_gradient, ()), (build_saliency, (["pool1"],))):
            found, wanted = outputs(build(model, layer, *extra)), outputs(build(small.nchw(), "relu2", *extra))
            assert all(np.allclose(a, b, atol=1e-6) for a, b in zip(found, wanted, strict=True))
    names = [value.name for value in build_gradient(small.nchw(), "relu2").graph.output]
    assert names == ["relu2", "gradient"]
    with pytest.raises(LayerError, match="seed's input can't be called 'saliency'"):
        build_saliency(small.nchw(), "relu2", seed="saliency")
