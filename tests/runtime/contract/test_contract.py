"""The contract: what is written is read back, and everything that does not fit is refused by name."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from elf_runtime import (
    ContractError,
    DescriptorSpec,
    DetectionParams,
    InputSpec,
    ModelContract,
    SettingError,
    WeightsSpec,
)
from elf_runtime.contract import ReductionSpec

CONTRACT = ModelContract(
    network="vgg",
    layer="pool2",
    stride=4.0,
    descriptors=(DescriptorSpec("descriptors_pool4", "pool4", 512, 16.0, 7.5),),
    detection=DetectionParams(denoise=(9, 3.0), scale=0.5),
    weights=WeightsSpec("somewhere", "ab" * 32, "CC BY 4.0"),
    parity={"max_error": 1e-3},
    cost={"params": 5.0},
    versions={"elf-onnx": "0.1.0"},
    command="elf-export --net vgg --layer pool2",
)


@dataclass
class Tensor:
    name: str
    type: str
    shape: list[object]


INPUT = Tensor("image", "tensor(float)", ["N", "H", "W", 3])
SALIENCY = Tensor("saliency", "tensor(float)", ["N", "H", "W"])
POOL4 = Tensor("descriptors_pool4", "tensor(float)", ["N", "h", "w", 512])


def test_what_is_written_is_read_back() -> None:
    metadata = CONTRACT.to_metadata()
    assert all(key.startswith("elf.") for key in metadata)
    assert ModelContract.from_metadata(metadata, "a.onnx") == CONTRACT


def test_keys_of_others_and_of_later_versions_are_left_alone() -> None:
    metadata = CONTRACT.to_metadata() | {"author": "me", "elf.future": "1"}
    assert ModelContract.from_metadata(metadata, "a.onnx") == CONTRACT


def test_a_reduction_is_recorded_and_may_be_absent() -> None:
    reduction = ReductionSpec("pca", 256, 0.75, 0.99, "the exporter's photographs", "cd" * 32)
    spec = DescriptorSpec("descriptors_conv3_3", "conv3_3", 128, 4.0, 1.5, reduction)
    metadata = replace(CONTRACT, descriptors=(spec,)).to_metadata()
    assert ModelContract.from_metadata(metadata, "a.onnx").descriptors == (spec,)
    (stated,) = json.loads(metadata["elf.descriptors"])
    # As a file of an earlier version has it, and as one of a later version may.
    later = {**stated, "reduction": {**stated["reduction"], "future": 1}, "future": 1}
    assert read_descriptors(later) == spec
    del stated["reduction"]
    assert read_descriptors(stated) == replace(spec, reduction=None)
    for wrong in (7, {"method": 7}, {"source_dim": "many"}):
        with pytest.raises(ContractError, match=r"'elf\.descriptors' is unreadable"):
            read_descriptors({**stated, "reduction": wrong})


def read_descriptors(stated: dict[str, object]) -> DescriptorSpec:
    metadata = CONTRACT.to_metadata() | {"elf.descriptors": json.dumps([stated])}
    return ModelContract.from_metadata(metadata, "a.onnx").descriptors[0]


def test_a_model_without_contract_is_told_how_to_get_one() -> None:
    with pytest.raises(ContractError, match=r"a\.onnx: not an ELF model.*--onnx a\.onnx --layer NAME --desc none"):
        ModelContract.from_metadata({"author": "me"}, "a.onnx")


def test_another_schema_names_both_versions_and_the_command() -> None:
    metadata = CONTRACT.to_metadata() | {"elf.schema": "99"}
    with pytest.raises(ContractError, match=r"a\.onnx.*'elf\.schema' is 99.*schema 1.*elf-export --net vgg"):
        ModelContract.from_metadata(metadata, "a.onnx")


@pytest.mark.parametrize("key", ["network", "layer", "stride", "input", "descriptors"])
def test_a_missing_key_is_named(key: str) -> None:
    metadata = CONTRACT.to_metadata()
    del metadata[f"elf.{key}"]
    with pytest.raises(ContractError, match=rf"'elf\.{key}' is missing"):
        ModelContract.from_metadata(metadata, "a.onnx")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("stride", '"four"'),
        ("network", "7"),
        ("network", "{"),
        ("parity", "[1]"),
        ("input", '{"color": "cmyk"}'),
        ("input", '{"color": 3}'),
        ("input", '{"layout": "NCHW"}'),
        ("input", "[]"),
        ("descriptors", '[{"output": "x"}]'),
        ("descriptors", '[{"output": "x", "layer": "l", "dim": 0, "stride": 1.0, "offset": 0.0}]'),
        ("descriptors", '[{"output": "x", "layer": "l", "dim": 8, "stride": 0.0, "offset": 0.0}]'),
        ("descriptors", '[{"output": "x", "layer": "l", "dim": 8, "stride": true, "offset": 0.0}]'),
        ("descriptors", '[{"output": "x", "layer": "l", "dim": 8, "stride": 1.0, "offset": false}]'),
        ("detection", '{"denoise": [4, 1.0]}'),
        ("detection", '{"nonsense": 1}'),
    ],
)
def test_an_unreadable_value_is_named(key: str, value: str) -> None:
    metadata = CONTRACT.to_metadata() | {f"elf.{key}": value}
    with pytest.raises(ContractError, match=rf"a\.onnx: metadata key 'elf\.{key}' is unreadable"):
        ModelContract.from_metadata(metadata, "a.onnx")


def test_tensors_that_fit() -> None:
    CONTRACT.check_tensors([INPUT], [SALIENCY, POOL4], "a.onnx")


@pytest.mark.parametrize(
    ("inputs", "outputs", "key"),
    [
        ([], [SALIENCY, POOL4], "input"),
        ([Tensor("x", "tensor(float)", ["N", "H", "W", 3])], [SALIENCY, POOL4], "input"),
        ([Tensor("image", "tensor(uint8)", ["N", "H", "W", 3])], [SALIENCY, POOL4], "input"),
        ([Tensor("image", "tensor(float)", ["N", 3, "H", "W"])], [SALIENCY, POOL4], "input"),
        ([Tensor("image", "tensor(float)", ["N", "H", "W", 1])], [SALIENCY, POOL4], "input"),
        ([Tensor("image", "tensor(float)", ["N", "H", "W", "C"])], [SALIENCY, POOL4], "input"),
        ([INPUT], [POOL4], "saliency_output"),
        ([INPUT], [Tensor("saliency", "tensor(float)", ["N", "H", "W", 1]), POOL4], "saliency_output"),
        ([INPUT], [SALIENCY], "descriptors"),
        ([INPUT], [SALIENCY, Tensor("descriptors_pool4", "tensor(float)", ["N", "h", "w", 256])], "descriptors"),
    ],
)
def test_tensors_that_disagree_are_refused(inputs: list[Tensor], outputs: list[Tensor], key: str) -> None:
    with pytest.raises(ContractError, match=rf"a\.onnx: 'elf\.{key}' says"):
        CONTRACT.check_tensors(inputs, outputs, "a.onnx")


def test_descriptor_by_layer() -> None:
    assert CONTRACT.descriptor() == CONTRACT.descriptor("pool4") == CONTRACT.descriptors[0]
    assert ModelContract("vgg", "pool2", 4.0).descriptor() is None
    with pytest.raises(SettingError, match=r"no descriptor layer 'pool9'.*pool4"):
        CONTRACT.descriptor("pool9")


def test_the_metadata_is_json() -> None:
    for value in CONTRACT.to_metadata().values():
        json.loads(value)


@pytest.mark.parametrize(
    "changes",
    [
        {"denoise": (4, 1.0)}, {"denoise": (0, 1.0)}, {"denoise": (5, 0.0)}, {"denoise": 5}, {"denoise": (-3, 1.0)},
        {"denoise": (1001, 1.0)}, {"denoise": (3, float("inf"))}, {"denoise": (3, float("nan"))},
        {"threshold_blur": (-3, 1.0)},
        {"threshold": "otsu"}, {"threshold": 1.5}, {"threshold": float("nan")}, {"nms_radius": -1}, {"nms_radius": 2.5},
        {"border": True}, {"max_keypoints": -1}, {"scale": 0}, {"scale": 100}, {"scale": "half"},
        {"normalize": 0.0}, {"quantize": 1}, {"colour": "red"},
    ],
)  # fmt: skip
def test_settings_out_of_range(changes: dict[str, object]) -> None:
    with pytest.raises(SettingError):
        DetectionParams().updated(**changes)


def test_the_ends_of_the_ranges_are_allowed() -> None:
    assert DetectionParams(scale=8.0, normalize=1.0, threshold=0.0).scale == 8.0
    assert DetectionParams(threshold=1.0, nms_radius=0, border=0, max_keypoints=0).threshold == 1.0


def test_numpy_s_integers_become_python_s() -> None:
    params = DetectionParams(nms_radius=np.int64(4), border=np.uint8(200), max_keypoints=np.int32(9))
    assert params == DetectionParams(nms_radius=4, border=200, max_keypoints=9)
    assert json.loads(json.dumps(params.to_dict()))["border"] == 200
    for value in (np.array(5), np.array([5]), np.float64(5), np.True_):
        with pytest.raises(SettingError, match="border is an integer"):
            DetectionParams(border=value)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["scale", "normalize", "threshold"])
def test_numbers_become_python_s(name: str) -> None:
    for value in (np.float32(0.5), np.float16(0.5), np.float64(0.5)):
        params = DetectionParams(**{name: value})  # type: ignore[arg-type]
        assert json.loads(json.dumps(params.to_dict()))[name] == 0.5
    for wrong in (np.array([0.5, 0.6]), np.array([0.5]), np.bool_(True), np.complex64(0.5), np.str_("0.5"), None):
        with pytest.raises(SettingError, match=f"^{name} is "):
            DetectionParams(**{name: wrong})  # type: ignore[arg-type]


def test_a_fixed_size_must_be_stated() -> None:
    fixed = Tensor("image", "tensor(float)", [1, 40, "W", 3])
    outputs = [SALIENCY, POOL4]
    spec = InputSpec(height=40, batch=1)
    replace(CONTRACT, input=spec).check_tensors([fixed], outputs, "a.onnx")
    with pytest.raises(ContractError, match=r"'elf\.input' says height free, the graph takes 40 only"):
        replace(CONTRACT, input=InputSpec(batch=1)).check_tensors([fixed], outputs, "a.onnx")
    with pytest.raises(ValueError, match="the batch is 0 or 1"):
        InputSpec(batch=10).check()


@pytest.mark.parametrize(
    ("spec", "scale", "size"),
    [
        (InputSpec(), 0.5, (60, 80)),
        (InputSpec(height=224, width=200), 1.0, (224, 200)),
        (InputSpec(height=60), 1.0, (60, 80)),
        (InputSpec(width=320), 1.0, (240, 320)),
        (InputSpec(multiple=32), 1.0, (128, 160)),
        (InputSpec(multiple=32, min_size=64), 0.3, (64, 64)),
        (InputSpec(multiple=32, min_size=65), 0.3, (96, 96)),
    ],
)
def test_the_size_that_the_graph_is_fed(spec: InputSpec, scale: float, size: tuple[int, int]) -> None:
    assert spec.size_for(120, 160, scale) == size
