"""Names of methods: files without folders, and long ones wrapped."""

from __future__ import annotations

import pytest

from elf_eval.report.method_names import without_folders, wrapped


def test_a_file_stands_without_its_folder_where_that_is_unambiguous():
    deep = "elf:/a/b/vgg.onnx?preset=paper"
    assert without_folders([deep, "elf:C:\\models\\alex.onnx", "sift", "elf?scale=1/2"]) == [
        "elf:vgg.onnx?preset=paper",
        "elf:alex.onnx",
        "sift",
        "elf?scale=1/2",
    ]
    both = ["elf:/a/vgg.onnx", "elf:/b/vgg.onnx"]
    assert without_folders(both) == both
    assert without_folders(["elf:/a/vgg.onnx", "elf:/b/vgg.onnx?scale=1"]) == [
        "elf:vgg.onnx",
        "elf:vgg.onnx?scale=1",
    ]
    assert without_folders([deep, deep]) == ["elf:vgg.onnx?preset=paper"] * 2


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        ("SIFT", ["SIFT"]),
        ("FAST + ORB", ["FAST", "+ ORB"]),
        ("elf:vgg.onnx?preset=paper&scale=1", ["elf:vgg.onnx?", "preset=paper&", "scale=1"]),
        ("the paper: ELF-VGG int8", ["the paper: ELF-", "VGG int8"]),
        ("x" * 40, ["x" * 16, "x" * 16, "x" * 8]),
        ("a" * 16 + "b" * 16 * 8 + "c" * 16, ["a" * 16, "...", "b" * 16, "c" * 16]),
    ],
)
def test_a_long_name_is_wrapped_and_loses_its_middle(name, lines):
    assert wrapped(name, 16, 4) == "\n".join(lines)
