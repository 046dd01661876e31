"""What models/README.md says of the bundled model is so."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace

import pytest

from elf_runtime import ElfRuntime, preset
from elf_runtime.model.bundled import BUNDLED, bundled_model
from elf_runtime.model.onnx_file import read_onnx
from helpers import ROOT

CARD = (ROOT / "models" / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(("label", "precision"), [("file", "fp32"), ("int8 file", "int8")])
def test_the_file_is_the_one_described(label: str, precision: str) -> None:
    data = bundled_model(precision).read_bytes()
    row = re.search(rf"^\| {label} \| ([\d ]+) bytes, SHA-256 `([0-9a-f]{{64}})` \|$", CARD, re.MULTILINE)
    assert row is not None, f"models/README.md has no row: | {label} | N bytes, SHA-256 `...` |"
    assert row[2] == hashlib.sha256(data).hexdigest()
    assert int(row[1].replace(" ", "")) == len(data)


def test_both_files_are_small_and_one_network() -> None:
    assert sum(bundled_model(precision).stat().st_size for precision in BUNDLED) <= 10_000_000
    full, lower = (ElfRuntime(bundled_model(precision)).contract for precision in ("fp32", "int8"))
    assert (full.precision, lower.precision) == ("fp32", "int8")
    assert (lower.network, lower.layer, lower.stride, lower.input) == (
        full.network, full.layer, full.stride, full.input
    )  # fmt: skip
    assert lower.detection == full.detection == preset("default")
    (mine,), (other,) = lower.descriptors, full.descriptors
    assert mine.reduction is not None
    assert other.reduction is not None
    assert mine.reduction.kept == pytest.approx(other.reduction.kept, abs=0.01)  # of the compressed network's variance
    assert replace(mine, reduction=replace(mine.reduction, kept=other.reduction.kept)) == other
    assert lower.weights == full.weights


def test_the_contract_is_the_one_described() -> None:
    contract = ElfRuntime().contract
    assert f"SHA-256 `{contract.weights.sha256}`" in CARD
    assert contract.weights.licence == "CC BY 4.0"
    params, descriptor = contract.detection, contract.descriptors[0]
    for text in (
        f"| {contract.layer} (stride {contract.stride:g},",
        f"| {descriptor.layer}: {descriptor.dim} values, a cell every {descriptor.stride:g} pixels",
        f"of the image at {descriptor.scale:g} of its size",
        f"working scale {params.scale:g}",
        f"denoise ({params.denoise[0]}, {params.denoise[1]:g})",
        f"threshold blur ({params.threshold_blur[0]}, {params.threshold_blur[1]:g})",
        f"the {params.normalize:g} quantile",
        f"nms_radius {params.nms_radius}, border {params.border}, at most {params.max_keypoints} keypoints",
    ):
        assert text in CARD, text


def test_ops_and_arithmetic_are_those_described() -> None:
    ops = {precision: len(read_onnx(bundled_model(precision)).nodes) for precision in BUNDLED}
    assert f"{ops['fp32']} (fp32) and {ops['int8']} (int8) standard ops" in CARD
    full, lower = (ElfRuntime(bundled_model(precision)).contract.cost for precision in ("fp32", "int8"))
    saliency, described, described_in_floats = (
        f"{cost[name]:,.0f}".replace(",", " ")
        for cost, name in (
            (lower, "saliency_macs_per_pixel"),
            (lower, "descriptors_macs_per_pixel"),
            (full, "descriptors_macs_per_pixel"),
        )
    )
    text = f"{saliency} multiply-adds per pixel for the saliency, {described} with the descriptors"
    assert f"{text} (int8; in fp32 {described_in_floats})" in CARD
