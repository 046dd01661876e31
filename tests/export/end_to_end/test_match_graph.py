"""The matching graph gives what `elf_runtime.match` gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime as ort
import pytest

from elf_export.cli import main
from elf_export.end_to_end.match import match_graph
from elf_runtime import match

Rows = npt.NDArray[np.float32]


def opened(model: bytes) -> ort.InferenceSession:
    options = ort.SessionOptions()
    options.log_severity_level = 3  # its word that inputs with defaults are no constants
    return ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])


@pytest.fixture(scope="module")
def session() -> ort.InferenceSession:
    return opened(match_graph().SerializeToString())


def found(session: ort.InferenceSession, a: Rows, b: Rows, ratio: float | None) -> tuple[npt.NDArray[np.int64], Rows]:
    given = {} if ratio is None else {"ratio": np.array(ratio, np.float32)}
    matches, similarity = session.run(["matches", "similarity"], {"descriptors_a": a, "descriptors_b": b, **given})
    return matches, similarity


def unit(rows: npt.NDArray[np.floating]) -> Rows:
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def sides(rng: np.random.Generator, first: int, second: int) -> tuple[Rows, Rows]:
    """Rows of unit length, some of the second side near some of the first, by several distances."""
    a = unit(rng.standard_normal((first, 24)))
    b = rng.standard_normal((second, 24))
    near = min(first, second) // 2
    b[:near] = a[rng.permutation(first)[:near]] + rng.uniform(0, 0.3, (near, 1)) * b[:near]
    return a, unit(b)


@pytest.mark.parametrize(
    "sizes", [(0, 0), (0, 1), (1, 0), (0, 7), (7, 0), (1, 1), (1, 2), (2, 1), (1, 50), (50, 1), (200, 150), (150, 200)]
)
def test_it_equals_the_runtime_s(session: ort.InferenceSession, sizes: tuple[int, int]) -> None:
    a, b = sides(np.random.default_rng(3), *sizes)
    counts = []
    for ratio in (1.0, 0.9, 0.6, 0.2):
        matches, similarity = found(session, a, b, ratio)
        wanted = match(a, b, float(np.float32(ratio)) if ratio < 1 else None)
        assert matches.dtype == np.int64
        np.testing.assert_array_equal(matches, wanted)
        products = (a[wanted[:, 0]].astype(np.float64) * b[wanted[:, 1]]).sum(axis=1)
        np.testing.assert_allclose(similarity, products, atol=1e-6)
        counts.append(len(matches))
    if min(sizes) > 100:
        assert counts[0] > counts[1] > counts[2] > counts[3] > 0


def test_the_ratio_s_default(session: ort.InferenceSession) -> None:
    a, b = sides(np.random.default_rng(4), 150, 150)
    np.testing.assert_array_equal(found(session, a, b, None)[0], found(session, a, b, 0.9)[0])
    strict = opened(match_graph(0.3).SerializeToString())
    np.testing.assert_array_equal(found(strict, a, b, None)[0], found(session, a, b, 0.3)[0])


def test_ties_go_to_the_lower_index(session: ort.InferenceSession) -> None:
    """Rows of four halves: float32 has their products as they are."""
    rng = np.random.default_rng(5)
    a, b = (rng.choice(np.array([-0.5, 0.5], np.float32), (30, 4)) for _ in range(2))
    matches, similarity = found(session, a, b, 1.0)
    np.testing.assert_array_equal(matches, match(a, b))
    assert 0 < len(matches) <= 16
    assert set(similarity) <= {np.float32(1), np.float32(0.5)}
    assert len(found(session, a, b, 0.99)[0]) == len(match(a, b, 0.99))
    same = np.full((3, 4), 0.5, np.float32)
    np.testing.assert_array_equal(found(session, same, same, 1.0)[0], [[0, 0]])
    assert len(found(session, same, same, 0.99)[0]) == 0


def test_what_is_nowhere_near_matches_too(session: ort.InferenceSession) -> None:
    """Opposite vectors, and ones of length 0, such as those of a flat image."""
    a = np.array([[1, 0]], np.float32)
    assert [x.tolist() for x in found(session, a, -a, 0.9)] == [[[0, 0]], [-1.0]]
    assert [x.tolist() for x in found(session, a, 0 * a, 0.9)] == [[[0, 0]], [0.0]]


def test_the_command_writes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], session: ort.InferenceSession
) -> None:
    path = tmp_path / "m.onnx"
    assert main(["--match", "-o", str(path)]) == 0
    assert capsys.readouterr().out == f"wrote {path} (4.0 kB): the descriptors of two images in, matches out\n"
    model = onnx.load(path)
    assert [(o.domain, o.version) for o in model.opset_import] == [("", 17)]
    assert model.producer_name == "elf-onnx"
    assert {node.domain for node in model.graph.node} == {""}
    a, b = sides(np.random.default_rng(6), 90, 80)
    np.testing.assert_array_equal(found(opened(path.read_bytes()), a, b, 0.8)[0], found(session, a, b, 0.8)[0])
    assert main(["--match", "-o", str(path)]) == 1
    assert "exists; --force overwrites it" in capsys.readouterr().err
    assert main(["--match", "-o", str(path), "--force", "-q"]) == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("words", [["--net", "vgg"], ["--precision", "int8"], ["--list"], ["--set", "scale=0.5"]])
def test_what_does_not_go_with_it(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--match", *words])
    assert caught.value.code == 2
    assert f"{words[0]} does not go with it" in capsys.readouterr().err
