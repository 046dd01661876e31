"""elf-export on models with one thing wrong: it lists and exports them, or says in one line why not."""

from __future__ import annotations

import itertools
import time
from pathlib import Path

import onnx
import pytest

from elf_export.cli import main
from elf_runtime import ElfRuntime
from export import small_models as small
from helpers import memory_needed_below, textured
from mutants.graphs import mutants

MODELS = {
    "convolutions": (small.nchw(), "relu2"),
    "pyramid": (small.pyramid(), "y"),
    "ConvNeXt": (small.convnext(), "y"),
}
SECONDS, BYTES = 20, 1.5e9


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.usefixtures("one_direction")
def test_only_our_errors_come_out(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, layer = MODELS[name]
    file, elf = tmp_path / "model.onnx", tmp_path / "elf.onnx"
    statuses = []
    for what, data in itertools.islice(mutants(model, seed=0), 21):
        file.write_bytes(data)
        elf.unlink(missing_ok=True)
        begun = time.monotonic()
        for options in (["--list"], ["--layer", layer, "--desc", layer, "-o", str(elf)]):
            with memory_needed_below(BYTES):
                status = main(["--onnx", str(file), *options])
            said = capsys.readouterr()
            assert status in (0, 1), f"{what}: {status}"
            if status:
                assert said.err.startswith("elf-export: error: "), what
                more = [line for line in said.err.splitlines()[1:] if not line.startswith("  ")]  # a list's rows
                assert not more or "can't be differentiated:" in said.err, f"{what}: {said.err}"
                assert "can't be handled" not in said.err, f"{what}: {said.err}"
            statuses.append(status)
        assert elf.exists() == (status == 0), what
        if status == 0:
            assert ElfRuntime(elf).saliency(textured(66, 71)).shape == (66, 71), what
        assert time.monotonic() - begun < SECONDS, what
    assert 0 in statuses


def test_a_seed_gives_the_same_mutants() -> None:
    first, again = (list(itertools.islice(mutants(small.nchw(), seed=3), 50)) for _ in range(2))
    assert first == again
    other = list(itertools.islice(mutants(small.nchw(), seed=4), 50))
    assert first != other
    assert len({data for _, data in first}) > 45
    for _, data in first:
        onnx.ModelProto.FromString(data)
