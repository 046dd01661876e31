"""benchmarks/node_times.py: every node of a profile in one kind of work, and the right one."""

from __future__ import annotations

import re
import runpy

import pytest

from elf_runtime.model import bundled_model
from helpers import ROOT

SCRIPT = runpy.run_path(str(ROOT / "benchmarks" / "node_times.py"))


@pytest.mark.parametrize("precision", ["fp32", "int8"])
def test_masks_are_told_from_the_network_s_convolutions(precision: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = bundled_model(precision)
    options = ["--size", "64x96", "--repeats", "1", "--threads", "1", "--nodes", "--outputs", "all"]
    assert SCRIPT["main"]([str(path), *options]) == 0
    text = capsys.readouterr().out
    kinds = dict.fromkeys(SCRIPT["KINDS"], 0)
    roles = re.compile("wins|mask|positive|minus|blocked|share|^saliency/")
    for kind, op, node in re.findall(r" ms  (\w[\w ]*?)  +(\S+) +(\S+)$", text, re.MULTILINE):
        kinds[kind] += 1
        if "Conv" in op:
            assert (kind == "convolution") == (roles.search(node) is None), node
        if op == "HardSigmoid":
            assert kind == "masks and differences", node
    assert all(kinds.values())
    shares = [float(share) for share in re.findall(r"(\S+)%$", text, re.MULTILINE)]
    assert len(shares) == len(SCRIPT["KINDS"])
    assert sum(shares) == pytest.approx(100, abs=0.4)
