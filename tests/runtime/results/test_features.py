"""Features: on disk, whatever the file is, and as values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elf_runtime import ElfError, ElfRuntime, Features
from elf_runtime.files.write import write_atomically
from helpers import TINY, textured


@pytest.fixture(scope="module")
def features() -> Features:
    return ElfRuntime(TINY, threads=1).detect(textured(120, 160), nms_radius=4)


def arrays(count: int = 3) -> dict[str, Any]:
    """What a file of features holds."""
    return {
        "keypoints": np.ones((count, 2), np.float32),
        "scores": np.ones(count, np.float32),
        "descriptors": np.ones((count, 4), np.float32),
        "image_size": np.array([20, 30]),
    }


def test_on_disk(features: Features, tmp_path: Path) -> None:
    features.save(tmp_path / "f.npz")
    found = Features.load(tmp_path / "f.npz")
    for name in ("keypoints", "scores", "descriptors", "sizes", "angles"):
        np.testing.assert_array_equal(getattr(found, name), getattr(features, name))
    assert (found.image_size, found.nms_radius) == (features.image_size, 4)
    assert found.to_cv2()[0][0].size == features.to_cv2()[0][0].size == 9
    features.save(tmp_path / "f.csv")
    lines = (tmp_path / "f.csv").read_text().splitlines()
    assert lines[0] == "x,y,score,size,angle"
    assert len(lines) == len(features) + 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["f.csv", "f.npz"]
    with pytest.raises(ElfError, match=r"saved as \.npz or \.csv"):
        features.save(tmp_path / "f.txt")


def test_a_file_without_nms_radius(tmp_path: Path) -> None:
    np.savez(tmp_path / "old.npz", **arrays())
    assert Features.load(tmp_path / "old.npz").nms_radius == 10.0


def test_double_precision_is_read_as_single(tmp_path: Path) -> None:
    np.savez(tmp_path / "f.npz", **{name: value.astype(np.float64) for name, value in arrays().items()})
    f = Features.load(tmp_path / "f.npz")
    assert {a.dtype for a in (f.keypoints, f.scores, f.descriptors)} == {np.dtype(np.float32)}


def test_a_radius_of_zero_is_read_again(tmp_path: Path) -> None:
    np.savez(tmp_path / "f.npz", nms_radius=0.0, **arrays())
    assert Features.load(tmp_path / "f.npz").nms_radius == 0


def test_csv_has_thousandths(tmp_path: Path) -> None:
    points, scores = np.array([[3.125, 4.0]], np.float32), np.array([9.875], np.float32)
    Features(points, scores, np.zeros((1, 0), np.float32), (20, 30)).save(tmp_path / "f.csv")
    assert (tmp_path / "f.csv").read_text().splitlines() == ["x,y,score,size,angle", "3.125,4.000,9.875,21.000,-1.000"]


def flipped(data: bytes) -> bytes:
    at = data.index(b"descriptors.npy") + 300
    return data[:at] + bytes(byte ^ 255 for byte in data[at : at + 40]) + data[at + 40 :]


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[: len(data) // 2],
        lambda data: data[:-10],
        lambda _: b"",
        lambda _: b"PK\x03\x04" + b"x" * 50,
        lambda _: b"x,y,score\n",
        flipped,
    ],
    ids=["half", "end", "empty", "zip", "text", "flipped"],
)
def test_damaged_files(features: Features, tmp_path: Path, damage: Any) -> None:
    path = tmp_path / "f.npz"
    features.save(path)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(ElfError, match=r"f\.npz: not a feature file: "):
        Features.load(path)


def test_other_files(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((3, 2), np.float32))
    np.savez(tmp_path / "b.npz", keypoints=np.zeros((3, 2)))
    np.savez(tmp_path / "c.npz", **{**arrays(), "keypoints": np.array([None])})
    for path in (tmp_path / "a.npy", tmp_path / "b.npz", tmp_path / "c.npz", tmp_path):
        with pytest.raises(ElfError, match=f"{path.name}: not a feature file: "):
            Features.load(path)
    (tmp_path / "d.npz").write_text("x,y,score")
    with pytest.raises(ElfError, match=r"d\.npz: not a feature file: it is no \.npz archive$"):
        Features.load(tmp_path / "d.npz")
    with pytest.raises(ElfError, match=r"absent\.npz: not a feature file: No such file or directory$"):
        Features.load(tmp_path / "absent.npz")


class Trap:
    """Unpickled, it makes the file that it names."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


def test_loading_runs_no_code_of_the_file(tmp_path: Path) -> None:
    sprung = tmp_path / "sprung"
    np.savez(tmp_path / "f.npz", **{**arrays(), "keypoints": np.array([Trap(sprung)], object)})
    with pytest.raises(ElfError, match="not a feature file"):
        Features.load(tmp_path / "f.npz")
    assert not sprung.exists()


@pytest.mark.parametrize(
    "changed",
    [
        {"image_size": np.array(20)},
        {"image_size": np.array([20, 30, 3])},
        {"image_size": np.array([0, 30])},
        {"image_size": np.array(["a", "b"])},
        {"scores": np.ones(5, np.float32)},
        {"scores": np.ones((3, 1), np.float32)},
        {"keypoints": np.ones((3, 3), np.float32)},
        {"keypoints": np.ones(6, np.float32)},
        {"keypoints": np.ones((3, 2), np.complex64)},
        {"keypoints": np.ones((3, 2), np.uint8)},
        {"scores": np.ones(3, np.uint8)},
        {"descriptors": np.ones((3, 4), np.uint8)},
        {"descriptors": np.ones((2, 4), np.float32)},
        {"descriptors": np.ones(3, np.float32)},
        {"descriptors": np.array([["a"] * 4] * 3)},
        {"nms_radius": np.array([1.0, 2.0])},
        {"nms_radius": np.nan},
        {"sizes": np.ones(2, np.float32)},
        {"sizes": np.ones(3, np.uint8)},
        {"sizes": np.array([1, 0, 1], np.float32)},
        {"sizes": np.array([1, np.inf, 1], np.float32)},
        {"angles": np.ones((3, 1), np.float32)},
        {"angles": np.array([0, -2, 0], np.float32)},
        {"angles": np.array([0, np.nan, 0], np.float32)},
    ],
    ids=lambda changed: "-".join(f"{key}{np.shape(value)}" for key, value in changed.items()),
)
def test_arrays_that_do_not_fit(tmp_path: Path, changed: dict[str, Any]) -> None:
    np.savez(tmp_path / "f.npz", **{**arrays(), **changed})
    with pytest.raises(ElfError, match=r"f\.npz: "):
        Features.load(tmp_path / "f.npz")


def test_nothing_found_is_a_file_too(tmp_path: Path) -> None:
    np.savez(tmp_path / "f.npz", **arrays(0))
    assert len(Features.load(tmp_path / "f.npz")) == 0


@pytest.mark.parametrize("ending", ["npz", "csv"])
def test_no_part_is_left_where_writing_fails(
    features: Features, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    folder = tmp_path / f"folder.{ending}"
    folder.mkdir()
    with pytest.raises(OSError, match=f"folder.{ending}'$"):
        features.save(folder)
    with pytest.raises(FileNotFoundError, match=f"absent/f.{ending}'$"):
        features.save(tmp_path / "absent" / f"f.{ending}")
    old = tmp_path / f"old.{ending}"
    old.write_bytes(b"old")

    def full(path: Path, *_: Any, **__: Any) -> None:
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match=f"No space left on device: '.*old.{ending}'"):
        features.save(old)
    assert old.read_bytes() == b"old"
    assert sorted(p.name for p in tmp_path.iterdir()) == [folder.name, old.name]


def test_an_interrupted_file_leaves_nothing(tmp_path: Path) -> None:
    def interrupted(path: Path) -> None:
        path.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "f.csv", interrupted)
    assert not list(tmp_path.iterdir())


def test_an_error_without_a_number_keeps_its_words(tmp_path: Path) -> None:
    def refused(_: Path) -> None:
        raise OSError("no such encoder")

    with pytest.raises(OSError, match=r"^no such encoder$"):
        write_atomically(tmp_path / "f.csv", refused)


def test_threads_and_processes_write_beside_each_other(tmp_path: Path) -> None:
    names: list[str] = []

    def write(path: Path) -> None:
        names.append(path.name)
        path.touch()

    write_atomically(tmp_path / "f.csv", write)
    write_atomically(tmp_path / "f.csv", write)
    assert names[0] != names[1]
    write_atomically(tmp_path / ("\u6c34" * 83 + ".csv"), write)  # 253 bytes, near the system's limit


def test_they_compare_by_identity(features: Features) -> None:
    other = Features(*(getattr(features, name) for name in ("keypoints", "scores", "descriptors", "image_size")))
    assert features == features
    assert features != other
    assert features in {features}
    trace = ElfRuntime(TINY, threads=1).trace(textured(64, 80))
    assert trace == trace


@pytest.mark.parametrize("name", ["keypoints", "scores"])
def test_places_and_scores_are_finite(name: str, tmp_path: Path) -> None:
    wrong = arrays(5)
    wrong[name].ravel()[3] = np.nan
    np.savez(tmp_path / "f.npz", **wrong)
    with pytest.raises(ElfError, match=f"f.npz: some {name} are NaN or infinite"):
        Features.load(tmp_path / "f.npz")
