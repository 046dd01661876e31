"""`Matches` against a plain loop: which, how similar, and in which order."""

from __future__ import annotations

import numpy as np
import pytest

from elf_runtime import Features, Matches, SettingError, match


def features(descriptors: np.ndarray) -> Features:
    """Features at (i, 2 i)."""
    index = np.arange(len(descriptors), dtype=np.float32)
    return Features(np.stack([index, 2 * index], axis=1), -index, descriptors, (99, 99))


def rows(count: int, seed: int, unit: bool) -> np.ndarray:
    drawn = np.random.default_rng(seed).standard_normal((count, 12))
    return (drawn / np.linalg.norm(drawn, axis=1, keepdims=True) if unit else drawn).astype(np.float32)


def plain(a: np.ndarray, b: np.ndarray, limit: float | None) -> list[tuple[float, float, int, int]]:
    """(ratio, -similarity, index, index) of mutual nearest neighbours in float64, sorted."""
    found = []
    a, b = a.astype(np.float64), b.astype(np.float64)
    for i, row in enumerate(a):
        distances = [float(np.linalg.norm(row - other)) for other in b]
        j = int(np.argmin(distances))
        back = int(np.argmin([float(np.linalg.norm(b[j] - other)) for other in a]))
        nearest, second = sorted(distances)[:2]
        if back == i and (limit is None or nearest < limit * second):
            found.append((nearest / second, nearest**2 / 2 - 1, i, j))
    return sorted(found)


@pytest.mark.parametrize("limit", [None, 0.9, 0.7])
@pytest.mark.parametrize("unit", [True, False])
def test_equal_a_plain_loop(unit: bool, limit: float | None) -> None:
    a, b = rows(60, 1, unit), rows(50, 2, unit)
    b[:30] = a[20:50][::-1] + 0.2 * b[:30]
    if unit:
        b /= np.linalg.norm(b, axis=1, keepdims=True)
    wanted = plain(a, b, limit)
    assert len(wanted) > 20
    found = Matches.between(a, b, limit)
    assert found.indices.tolist() == [[i, j] for _, _, i, j in wanted]
    np.testing.assert_allclose(found.ratio, [row[0] for row in wanted], atol=1e-5)
    np.testing.assert_allclose(found.similarity, [-row[1] for row in wanted], rtol=1e-5, atol=1e-5)
    assert (found.indices.dtype, found.similarity.dtype, found.ratio.dtype) == (np.int64, np.float32, np.float32)
    if unit:
        cosines = [float(a[i] @ b[j]) for i, j in found.indices]
        np.testing.assert_allclose(found.similarity, cosines, atol=1e-5)


def test_are_those_of_match_and_pass_the_recommended_ratio() -> None:
    a, b = rows(80, 3, True), rows(80, 4, True)
    for limit in (None, 0.8):
        pairs = match(a, b, limit)
        found = Matches.between(a, b, limit)
        assert found.indices[np.argsort(found.indices[:, 0])].tolist() == pairs.tolist()
    assert len(Matches.between(a, b)) == len(match(a, b, 0.9)) < len(match(a, b))


def test_one_descriptor_has_no_second_nearest_and_twins_have_ratio_one() -> None:
    x, y = np.eye(2, dtype=np.float32)
    single = Matches.between(np.stack([y, 0.6 * y + 0.8 * x]), x[None])
    assert single.indices.tolist() == [[1, 0]]
    assert single.ratio.tolist() == [0.0]
    twins = Matches.between(x[None], np.stack([x, x]), ratio=None)
    assert (twins.indices.tolist(), twins.ratio.tolist()) == ([[0, 0]], [1.0])


def test_equal_matches_stay_by_the_first_index() -> None:
    found = Matches.between(np.eye(5, dtype=np.float32), np.eye(5, dtype=np.float32)[::-1])
    assert found.indices.tolist() == [[i, 4 - i] for i in range(5)]


def test_a_part_has_the_same_order() -> None:
    found = Matches.between(rows(40, 1, True), rows(40, 2, True), None)
    mask = np.arange(len(found)) % 2 == 1
    for index in (slice(3, 7), mask, np.array([4, 0])):
        part = found[index]
        assert len(part) == len(found.indices[index])
        np.testing.assert_array_equal(part.indices, found.indices[index])
        np.testing.assert_array_equal(part.similarity, found.similarity[index])
        np.testing.assert_array_equal(part.ratio, found.ratio[index])
    assert found[-1].indices.tolist() == [found.indices[-1].tolist()]
    assert [one.indices[0].tolist() for one in found] == found.indices.tolist()
    with pytest.raises(IndexError):
        found[len(found)]


def test_points_and_opencvs_matches() -> None:
    a, b = rows(30, 1, True), rows(40, 2, True)
    found = Matches.between(a, b, None)
    first, second = found.points(features(a), features(b))
    assert first.tolist() == [[i, 2 * i] for i, _ in found.indices.tolist()]
    assert second.tolist() == [[j, 2 * j] for _, j in found.indices.tolist()]
    assert [[m.queryIdx, m.trainIdx] for m in found.to_cv2()] == found.indices.tolist()
    distances = [float(np.linalg.norm(a[i] - b[j])) for i, j in found.indices]
    np.testing.assert_allclose([m.distance for m in found.to_cv2()], distances, atol=1e-4)
    with pytest.raises(SettingError, match="are not of these features, 30 and 3"):
        found.points(features(a), features(b[:3]))


def test_another_matcher_s_pairs_keep_their_order() -> None:
    found = Matches.of([[4, 1], [0, 3], [2, 2]])
    assert found.indices.tolist() == [[4, 1], [0, 3], [2, 2]]
    assert (found.indices.dtype, found.similarity.dtype, found.ratio.dtype) == (np.int64, np.float32, np.float32)
    assert (found.similarity.tolist(), found.ratio.tolist()) == ([0, 0, 0], [1, 1, 1])
    first, second = found.points(features(rows(5, 1, True)), features(rows(4, 2, True)))
    assert (first.tolist(), second.tolist()) == ([[4, 8], [0, 0], [2, 4]], [[1, 2], [3, 6], [2, 4]])
    assert len(Matches.of(np.zeros((0, 2)))) == 0
    for wrong in ([1, 2, 3], [[0.5, 1.0]], [[0, -1]], [[0, 1, 2]]):
        with pytest.raises(SettingError, match="matches "):
            Matches.of(wrong)


def test_nothing_matches_nothing() -> None:
    none = Matches.between(features(rows(0, 1, True)), features(rows(5, 1, True)))
    assert (len(none), none.indices.shape, none.similarity.shape, none.ratio.shape) == (0, (0, 2), (0,), (0,))
    first, second = none.points(features(rows(0, 1, True)), features(rows(5, 1, True)))
    assert first.shape == second.shape == (0, 2)
    assert (none.to_cv2(), repr(none)) == ([], "Matches(0)")


def test_say_what_they_are_and_refuse_what_match_refuses() -> None:
    found = Matches(np.array([[0, 0], [1, 2]]), np.float32([0.5, 0.4]), np.float32([0.625, 0.75]))
    assert repr(found) == "Matches(2, ratio 0.62 to 0.75)"
    with pytest.raises(SettingError, match="ratio"):
        Matches.between(rows(3, 1, True), rows(3, 2, True), ratio=1.0)
    with pytest.raises(SettingError, match="can't be compared"):
        Matches.between(rows(3, 1, True), rows(3, 2, True)[:, :4])


def test_similarities_of_huge_rows_are_finite() -> None:
    far = Matches.between(np.full((1, 4), 1e30), np.zeros((2, 4)), None)
    assert np.isfinite(far.similarity).all()
    assert far.ratio.tolist() == [1.0]
