"""Shorter descriptors: the fit, against an SVD."""

from __future__ import annotations

import numpy as np
import pytest

from elf_export import LayerError, Reduction
from elf_export.command.asked import reduction_of
from elf_export.command.options import parser
from elf_export.descriptors.projection import fit, moments, thinned
from export.descriptors.svd import by_svd


@pytest.mark.parametrize(("dim", "whiten"), [(1, 0.0), (4, 0.0), (4, 0.5), (10, 1.0)])
def test_pca_is_the_svd_s(cells: np.ndarray, dim: int, whiten: float) -> None:
    projection = fit(np.array_split(cells, 7), Reduction(dim, whiten=whiten))
    variance, scores = by_svd(cells, dim, whiten)
    found = projection(cells)
    signs = np.sign((found * scores).sum(axis=0))
    np.testing.assert_allclose(found, scores * signs, atol=1e-9)
    assert projection.kept == pytest.approx(variance.sum() / cells.var(axis=0, ddof=1).sum())


def test_a_component_s_largest_coefficient_is_positive(cells: np.ndarray) -> None:
    for some in (cells, -cells):
        matrix = fit([some], Reduction(10, whiten=0.0)).matrix
        assert (matrix[np.abs(matrix).argmax(axis=0), np.arange(10)] > 0).all()


def test_components_are_whitened_unless_told_otherwise(cells: np.ndarray) -> None:
    assert Reduction(4, "channels").exponent == 0.0
    found = fit([cells], Reduction(4))(cells).var(axis=0, ddof=1)
    variance = by_svd(cells, 4, 0.0)[0]
    np.testing.assert_allclose(found / found[0], (variance / variance[0]) ** 0.25)


def test_channels_are_those_that_vary_most(cells: np.ndarray) -> None:
    projection = fit([cells], Reduction(3, "channels"))
    chosen = sorted(range(10), key=lambda c: -cells[:, c].var())[:3]
    np.testing.assert_array_equal(projection(cells), cells[:, chosen])
    assert projection.kept == pytest.approx(cells[:, chosen].var(axis=0).sum() / cells.var(axis=0).sum())


def test_moments_of_batches_are_those_of_all(cells: np.ndarray) -> None:
    far = cells.astype(np.float32) + 1e4  # where a sum of squares would cancel
    mean, covariance = moments([far[:1], far[1:1], far[1:700], far[700:]])
    np.testing.assert_allclose(mean, far.astype(np.float64).mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(covariance, np.cov(far.astype(np.float64).T), rtol=1e-9, atol=1e-9)


def test_a_large_map_is_thinned_evenly() -> None:
    grid = np.stack(np.mgrid[:300, :200], axis=-1).astype(np.float32)
    rows = thinned(grid)
    np.testing.assert_array_equal(np.unique(rows[:, 0]), np.arange(0, 300, 2))
    np.testing.assert_array_equal(np.unique(rows[:, 1]), np.arange(0, 200, 2))
    assert len(thinned(grid[:100, :200])) == 20_000
    assert len(thinned(grid[:101, :200])) == 51 * 100


def test_moments_of_few_rows_are_finite(cells: np.ndarray) -> None:
    mean, covariance = moments([cells[:0], cells[:1]])
    np.testing.assert_array_equal(mean, cells[0])
    np.testing.assert_array_equal(covariance, np.zeros((10, 10)))
    again, spread = moments([cells[:0], cells[:700], cells[:0], cells[700:]])
    np.testing.assert_allclose(again, cells.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(spread, np.cov(cells.T), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"dim": 0}, "at least 1 value, not 0"),
        ({"dim": 2, "method": "lda"}, "by pca or channels, not by 'lda'"),
        ({"dim": 2, "whiten": 1.5}, r"a number in \[0, 1\], not 1.5"),
        ({"dim": 2, "whiten": -0.5}, r"a number in \[0, 1\], not -0.5"),
        ({"dim": 2, "method": "channels", "whiten": 0.5}, "goes with pca only"),
    ],
)
def test_reductions_that_make_no_sense(wanted: dict, message: str) -> None:
    with pytest.raises(LayerError, match=message):
        Reduction(**wanted)


def test_more_than_there_is(cells: np.ndarray) -> None:
    with pytest.raises(LayerError, match="it has 10 channels, fewer than the 11 asked for"):
        fit([cells], Reduction(11))
    with pytest.raises(LayerError, match="vary in 9 directions over the calibration images, fewer than the 10"):
        fit([np.c_[cells[:, :9], cells[:, :9] @ np.ones(9)]], Reduction(10))
    with pytest.raises(LayerError, match="vary in 0 directions over the calibration images, fewer than the 1"):
        fit([np.ones((10, 4), np.float32)], Reduction(1))


def test_a_direction_counts_from_a_millionth_of_the_largest_variance() -> None:
    square = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
    for ratio in (1.2e-6, 0.5):
        found = fit([square * (1.0, ratio**0.5)], Reduction(2, whiten=0.0))
        np.testing.assert_allclose(np.abs(found.matrix), np.eye(2), atol=1e-12)
    with pytest.raises(LayerError, match="vary in 1 directions"):
        fit([square * (1.0, 0.8e-6**0.5)], Reduction(2, whiten=0.0))


def test_channels_may_be_asked_not_to_be_whitened() -> None:
    assert Reduction(2, "channels", whiten=0.0).exponent == 0.0


@pytest.mark.parametrize(
    "reduction",
    [Reduction(8, whiten=1 / 3), Reduction(8, whiten=0.0, separate=True), Reduction(8), Reduction(8, "channels")],
)
def test_the_options_say_the_same_reduction_to_the_last_digit(reduction: Reduction) -> None:
    found = reduction_of(parser().parse_args(["--net", "vgg", *reduction.words()]))
    assert found is not None
    assert (found.dim, found.method, found.separate) == (reduction.dim, reduction.method, reduction.separate)
    assert found.exponent == reduction.exponent
