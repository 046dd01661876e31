"""A small suite, and what its run may use."""

from __future__ import annotations

import pytest

from elf_eval.protocol import Protocol
from elf_eval.run.runner import Resources
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite


@pytest.fixture
def resources(tmp_path):
    return Resources(tmp_path / "cache", threads=1, quiet=True)


@pytest.fixture
def suite(hpatches_folder):
    return Suite(
        methods=[
            MethodEntry("SIFT", "sift"),
            MethodEntry("few", "sobel?nms_radius=20"),
            MethodEntry("ORB", "orb"),
        ],
        datasets=[DatasetEntry("two", f"hpatches:{hpatches_folder}")],
        protocol=Protocol(size=(160, 120), max_keypoints=60, counts=("own", "equal")),
    )
