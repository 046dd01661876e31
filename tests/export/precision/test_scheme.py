"""Schemes of 8-bit integers: how finely values and weights are rounded."""

from __future__ import annotations

import numpy as np
import pytest

from elf_export.precision.int8.scheme import LEVELS, SHARES, WEIGHT_LEVELS, Scheme, fitted, reaching, weights


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("outlier", [1.0, 200.0])
def test_the_fitted_scheme_loses_least(signed: bool, outlier: float) -> None:
    """Against 100 clipping ranges of uint8 codes, written out; zero is exact and never negative wastes no level."""
    rng = np.random.default_rng(0)
    x = rng.laplace(size=300_000).astype(np.float32)
    x[0] = outlier
    x = x if signed else np.abs(x)
    scheme = fitted(x)
    assert scheme.zero == (128 if signed else 0)
    assert scheme.scale == np.float32(scheme.scale)

    def loss(scale: float) -> float:
        low, high = (-128, 127) if signed else (0, 255)
        codes = np.minimum(np.maximum(np.round(x.astype(np.float64) / scale), low), high)
        return float(((codes * scale - x) ** 2).sum())

    top = np.abs(x).max() / (127 if signed else 255)
    best = min(loss(top * share) for share in np.linspace(0.1, 1, 100))
    assert loss(scheme.scale) <= 1.02 * best
    np.testing.assert_allclose(((scheme.rounded(x) - x) ** 2).sum(), loss(scheme.scale))
    assert scheme.rounded(np.zeros(1)) == 0
    assert scheme.scale < 0.9 * top, "the largest value costs all others their steps"


@pytest.mark.parametrize("values", [np.zeros(4, np.float32), np.zeros(0, np.float32)])
def test_nothing_to_fit(values: np.ndarray) -> None:
    assert fitted(values) == Scheme(1 / 255)


def test_weights_are_rounded_channel_by_channel() -> None:
    rng = np.random.default_rng(0)
    kernel = rng.standard_normal((5, 4, 3, 3)) * np.geomspace(1e-4, 1e3, 5)[:, None, None, None]
    kernel[2] = 0
    q, scales = weights(kernel)
    assert (q.dtype, scales.dtype) == (np.int8, np.float32)
    assert (scales > 0).all()
    error = np.abs(q * scales[:, None, None, None].astype(np.float64) - kernel)
    assert (error.max(axis=(1, 2, 3)) <= 0.5001 * scales).all()
    tops = np.abs(q).max(axis=(1, 2, 3))
    np.testing.assert_array_equal(tops, [63, 63, 0, 63, 63])


def test_two_products_fit_16_bits() -> None:
    """What x86 processors without VNNI add up in int16 (VPMADDUBSW): two of uint8 times int8."""
    assert 2 * LEVELS * WEIGHT_LEVELS < 2**15
    assert 2 * LEVELS * (2 * WEIGHT_LEVELS) >= 2**15  # no bit is given away
    assert max(SHARES) == 1.0


@pytest.mark.parametrize("top", [6.0, 1.0, 0.1, 20.0, *np.random.default_rng(0).uniform(0, 9, 40).astype(np.float32)])
def test_the_highest_level_is_the_bound_itself(top: float) -> None:
    scale = np.float32(reaching(float(np.float32(top))).scale)
    assert scale * np.float32(255) == np.float32(top)
