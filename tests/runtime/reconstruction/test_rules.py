"""elf-reconstruct: which images are matched, by --pairs."""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np
import pytest

from elf_runtime import Features, global_descriptor
from elf_runtime.commands.reconstruct_steps import Steps
from elf_runtime.reconstruction import Camera, Model

NAMES = ["a.jpg", "b.jpg", "sub/c.jpg", "sub/d.jpg"]


@pytest.fixture
def found() -> dict[str, Features]:
    """Features of which a is most like d, and b most like c."""
    rng = np.random.default_rng(0)
    kinds = {name: rng.standard_normal((8, 8)) for name in ("one", "other")}

    def features(kind: str) -> Features:
        rows = rng.standard_normal((200, 8)) @ kinds[kind]
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        return Features(
            np.zeros((200, 2), np.float32), np.ones(200, np.float32), rows.astype(np.float32), image_size=(48, 64)
        )

    return dict(zip(NAMES, map(features, ("one", "other", "other", "one")), strict=True))


def pairs(found: dict[str, Features], rule: str, folder: Path = Path()) -> list[tuple[str, str]]:
    return Steps(argparse.Namespace(pairs=rule, folder=folder, quiet=True), io.StringIO())._pairs(found)


@pytest.mark.parametrize(("share", "quiet"), [("folder", False), ("all", False), ("folder", True)])
def test_improbable_cameras_are_warned_of(share: str, quiet: bool, capsys: pytest.CaptureFixture[str]) -> None:
    camera = Camera("SIMPLE_RADIAL", (2424.0, 320.0, 240.0, 0.0), (480, 640))
    model = Model({}, {"a.jpg": camera}, np.zeros((0, 3)), np.zeros((0, 3), np.uint8), {}, 0.0, 0.0)
    steps = Steps(argparse.Namespace(share=share, quiet=quiet), io.StringIO())
    (found,) = steps._warnings([model], {"a.jpg": Camera.guessed((480, 640))})
    assert found.startswith("a.jpg: focal length 2424 px, where the search began with 768; the model may be wrong, ")
    assert ("--share all" in found, "--K" in found) == (share != "all", True)
    assert capsys.readouterr().err == ("" if quiet else f"elf-reconstruct: warning: {found}\n")


def test_by_order(found: dict[str, Features]) -> None:
    a, b, c, d = NAMES
    assert pairs(found, "exhaustive") == [(a, b), (a, c), (a, d), (b, c), (b, d), (c, d)]
    assert pairs(found, "sequential") == pairs(found, "sequential:1") == [(a, b), (b, c), (c, d)]
    assert pairs(found, "sequential:9") == pairs(found, "exhaustive")


def test_by_likeness(found: dict[str, Features]) -> None:
    a, b, c, d = NAMES
    pooled = np.stack([global_descriptor(features) for features in found.values()])
    assert np.corrcoef(pooled - pooled.mean(axis=0))[0].argsort().tolist()[-2] == 3
    assert pairs(found, "nearest:1") == [(a, d), (b, c)]
    assert pairs(found, "nearest:9") == pairs(found, "exhaustive")


def test_by_a_list_whose_images_could_not_all_be_read(found: dict[str, Features], tmp_path: Path) -> None:
    for name in [*NAMES, "bad.jpg"]:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "list").write_text("# mine\nsub/d.jpg a.jpg\nbad.jpg a.jpg\nb.jpg a.jpg\n")
    assert pairs(found, str(tmp_path / "list"), tmp_path) == [("sub/d.jpg", "a.jpg"), ("b.jpg", "a.jpg")]
