"""Nothing recognises what a lowering has written; what the rooms look like."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from elf_export.dialect import OPS
from elf_export.dialect.reference import OPERATORS
from elf_export.lowering import TARGETS
from elf_export.lowering.steps import STEPS
from helpers import ROOT

EXPORT = ROOT / "export" / "elf_export"
# A steep slope, a kernel of -1 and 1, and the names of the adjoint's nodes.
RECOGNISING = re.compile(r"1e[23]0|STEEP|HardSigmoid|adj/|ADJOINT|endswith\(|== ?-1\)|_difference")
READERS = [*sorted((EXPORT / "precision").rglob("*.py")), *sorted((EXPORT / "graph" / "passes").glob("*.py"))]
# What HardSigmoid does to a value's axes, and standard operators that fused and quantised ones are written as.
OF_THE_NETWORK = {"fused_ops.py", "quantized_ops.py"}


@pytest.mark.parametrize("path", READERS, ids=lambda path: path.name)
def test_no_pass_recognises_an_idiom(path: Path) -> None:
    if path.name in OF_THE_NETWORK:
        pytest.skip("names operators of networks that are read, before anything is differentiated")
    assert not RECOGNISING.findall(path.read_text(encoding="utf-8"))


def test_nor_does_a_benchmark() -> None:
    for path in (ROOT / "benchmarks").glob("*.py"):
        assert not re.search(r"1e[23]0|adj/|ADJOINT|_difference|== ?-1\)", path.read_text(encoding="utf-8")), path.name


def test_rules_do_not_choose_among_forms() -> None:
    words = re.compile(r"channels_last|Phases|HardSigmoid.*alpha|elf_export\.lowering")
    for path in (EXPORT / "adjoint").rglob("*.py"):
        assert not words.search(path.read_text(encoding="utf-8")), path.name


def test_every_target_writes_its_steps_and_every_operation_has_its_reference() -> None:
    assert set(TARGETS) <= set(STEPS)
    assert {operator.__name__ for operator in OPERATORS} == set(OPS)


@pytest.mark.parametrize("room", ["adjoint", "lowering", "dialect", "precision"])
def test_functions_are_short(room: str) -> None:
    for path in (EXPORT / room).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                assert node.end_lineno - node.lineno < 60, f"{path.name}: {node.name}"


def test_the_engine_is_short() -> None:
    assert len((EXPORT / "adjoint" / "engine.py").read_text(encoding="utf-8").splitlines()) < 150
