"""Fingerprints: they change with the code that computes a figure, and with nothing else."""

from __future__ import annotations

import shutil

import pytest

from elf_eval import fingerprint
from elf_eval.fingerprint import code_digest
from elf_eval.methods import elf, gradient
from elf_eval.metrics import pair
from elf_eval.run import refinement
from helpers import ROOT


@pytest.fixture
def packages(tmp_path, monkeypatch):
    """Copies of the packages, whose files a test may change."""
    folders = {"elf_runtime": ROOT / "runtime" / "elf_runtime", "elf_eval": ROOT / "evaluation" / "elf_eval"}
    for name, folder in folders.items():
        shutil.copytree(folder, tmp_path / name, ignore=shutil.ignore_patterns("*.onnx", "__pycache__"))
    monkeypatch.setattr(fingerprint, "_PACKAGES", {name: tmp_path / name for name in folders})
    fingerprint._statements.cache_clear()
    yield tmp_path
    fingerprint._statements.cache_clear()


def changes(packages, file, text="CHANGED = 1\n"):
    """Whether more text in a file changes the fingerprints of ELF, of image gradients and of a pair's metrics."""
    codes = (elf.CODE, gradient.CODE, pair.CODE)
    before = [code_digest(*code) for code in codes]
    path = packages / file
    path.write_text(path.read_text() + text)
    fingerprint._statements.cache_clear()
    return [code_digest(*code) != digest for code, digest in zip(codes, before, strict=True)]


@pytest.mark.parametrize(
    ("file", "changed"),
    [
        ("elf_runtime/engine/runtime.py", [True, False, False]),
        ("elf_runtime/params.py", [True, True, False]),
        ("elf_runtime/contract/model.py", [True, False, False]),
        ("elf_runtime/detection/threshold.py", [True, True, False]),
        ("elf_runtime/detection/descriptors.py", [True, False, False]),
        ("elf_runtime/model/session.py", [True, False, False]),
        ("elf_runtime/image/convert.py", [True, False, False]),
        ("elf_runtime/results/features.py", [True, False, False]),
        ("elf_runtime/checks/greedy.py", [False, False, True]),
        ("elf_runtime/commands/detect.py", [False, False, False]),
        ("elf_runtime/pictures/render.py", [False, False, False]),
        ("elf_runtime/geometry/two_view.py", [False, False, False]),
        ("elf_eval/features.py", [True, True, True]),
        ("elf_eval/methods/elf.py", [True, False, False]),
        ("elf_eval/methods/gradient.py", [False, True, False]),
        ("elf_eval/metrics/pose.py", [False, False, True]),
        ("elf_eval/metrics/intervals.py", [False, False, False]),
        ("elf_eval/data/truth.py", [False, False, True]),
        ("elf_eval/run/runner.py", [False, False, False]),
        ("elf_eval/report/plots.py", [False, False, False]),
    ],
)
def test_a_changed_file_changes_what_it_computes(packages, file, changed):
    assert changes(packages, file) == changed


def test_comments_imports_and_docstrings_change_nothing(packages):
    assert not any(changes(packages, "elf_eval/features.py", '\n# why\nimport math\n"""A text."""\n'))


def test_a_moved_file_changes_nothing(packages):
    before = code_digest("elf_runtime.detection")
    (packages / "elf_runtime" / "detection" / "deeper").mkdir()
    shutil.move(packages / "elf_runtime/detection/nms.py", packages / "elf_runtime/detection/deeper/suppression.py")
    assert code_digest("elf_runtime.detection") == before


# What the errors say, how files are read and written, pictures, what is done with results afterwards, and the settings,
# which stand in the fingerprints themselves.
HARMLESS = (
    *("elf_runtime.errors", "elf_runtime.files", "elf_runtime.plain", "elf_runtime.version", "elf_runtime.indices"),
    *("elf_runtime.pictures", "elf_runtime.results.files", "elf_runtime.results.opencv"),
    *("elf_runtime.results.quantization", "elf_eval.errors", "elf_eval.protocol"),
)


@pytest.mark.parametrize(
    ("code", "roots"),
    [
        (elf.CODE, ["elf_runtime.engine.runtime"]),
        (gradient.CODE, ["elf_runtime.detection.nms", "elf_runtime.detection.threshold"]),
        (pair.CODE, ["elf_eval.metrics.pair"]),
        (refinement.CODE, ["elf_eval.run.refinement"]),
    ],
)
def test_nothing_that_is_imported_on_the_way_is_forgotten(code, roots):
    grimp = pytest.importorskip("grimp")
    graph = grimp.build_graph("elf_runtime", "elf_eval", cache_dir=None, exclude_type_checking_imports=True)
    needed = {*roots, *(module for root in roots for module in graph.find_upstream_modules(root))}
    assert [m for m in sorted(needed) if not f"{m}.".startswith(tuple(f"{c}." for c in (*code, *HARMLESS)))] == []
