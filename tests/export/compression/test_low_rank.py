"""Convolutions in low rank against brute force: exact at full rank, and nearest of all maps of a rank."""

from __future__ import annotations

import numpy as np
import pytest

from elf_export.compression.low_rank import LowRank, approximate, approximate_rectified, spectrum

Rows = np.ndarray


def responses(seed: int = 3, count: int = 2000, channels: int = 8) -> Rows:
    """(n, D) correlated, off the origin; no two variances are close."""
    rng = np.random.default_rng(seed)
    turned = np.linalg.qr(rng.standard_normal((channels, channels)))[0]
    return rng.standard_normal((count, channels)) * 0.6 ** np.arange(channels) @ turned + rng.uniform(-1, 1, channels)


def disturbed(wanted: Rows, seed: int = 4) -> Rows:
    """The responses of the same kernels to another input: mixed, shifted, and with noise."""
    rng = np.random.default_rng(seed)
    mixed = wanted @ (np.eye(wanted.shape[1]) + 0.2 * rng.standard_normal((wanted.shape[1],) * 2)) + 0.3
    return mixed + 0.05 * rng.standard_normal(wanted.shape)


def loss(low: LowRank, wanted: Rows, given: Rows, rectified: bool = False) -> float:
    found = low(given)
    if rectified:
        found, wanted = np.maximum(found, 0), np.maximum(wanted, 0)
    return float(np.square(found - wanted).mean())


@pytest.mark.parametrize("balance", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("fit", [approximate, approximate_rectified])
def test_full_rank_is_exact(fit: type, balance: float) -> None:
    y = responses()
    np.testing.assert_allclose(fit(y, y, 8, balance)(y), y, atol=1e-9)


@pytest.mark.parametrize("rank", [1, 3, 7])
def test_of_a_network_that_is_whole_before_it_is_the_principal_components(rank: int) -> None:
    """Eckart and Young: what is lost are the smallest singular values of the centred responses."""
    y = responses()
    centred = y - y.mean(axis=0)
    u, s, vt = np.linalg.svd(centred, full_matrices=False)
    low = approximate(y, y, rank)
    np.testing.assert_allclose(low(y), (u * s)[:, :rank] @ vt[:rank] + y.mean(axis=0), atol=1e-9)
    assert loss(low, y, y) * y.size == pytest.approx((s[rank:] ** 2).sum())
    np.testing.assert_allclose(spectrum(y), s**2 / len(y))


@pytest.mark.parametrize("rank", [1, 2, 5])
def test_no_other_map_of_the_rank_is_nearer(rank: int) -> None:
    """Alternating least squares from many beginnings come no nearer than the closed form, and as near."""
    y = responses()
    x = disturbed(y)
    mine = loss(approximate(y, x, rank), y, x)
    a, b = x - x.mean(axis=0), y - y.mean(axis=0)
    found = []
    for seed in range(5):
        v = np.random.default_rng(seed).standard_normal((rank, 8))
        for _ in range(300):
            u = np.linalg.lstsq(a @ v.T, b, rcond=None)[0].T  # (D, r)
            v = np.linalg.pinv(u) @ np.linalg.lstsq(a, b, rcond=None)[0].T
        found.append(float(np.square(a @ v.T @ u.T - b).mean()))
    assert mine <= min(found) * (1 + 1e-9)
    assert mine == pytest.approx(min(found), rel=1e-4)


def test_errors_of_the_network_before_it_are_made_good() -> None:
    """At full rank: the least-squares map, which the kernels as they were trained are not."""
    y = responses()
    x = disturbed(y)
    ones = np.c_[x, np.ones(len(x))]
    wanted = ones @ np.linalg.lstsq(ones, y, rcond=None)[0]
    np.testing.assert_allclose(approximate(y, x, 8)(x), wanted, atol=1e-9)
    assert loss(approximate(y, x, 6), y, x) < 0.2 * loss(approximate(y, y, 6), y, x)


@pytest.mark.parametrize("rank", [2, 4])
def test_behind_a_relu_the_rectified_form_is_nearer(rank: int) -> None:
    y = responses() - 0.5
    x = disturbed(y)
    linear, rectified = (loss(fit(y, x, rank), y, x, True) for fit in (approximate, approximate_rectified))
    assert rectified < 0.95 * linear


@pytest.mark.parametrize("balance", [0.0, 0.5, 1.0])
def test_balance_evens_the_middle_and_changes_no_value(balance: float) -> None:
    y = responses()
    low = approximate(y, y, 4, balance)
    np.testing.assert_allclose(low(y), approximate(y, y, 4, 0.0)(y), atol=1e-9)
    middle = y @ low.reduce.T + low.shift
    np.testing.assert_allclose(middle.mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(middle.std(axis=0), np.sqrt(spectrum(y)[:4]) ** (1 - balance), rtol=1e-6)
    assert (low.expand[np.abs(low.expand).argmax(axis=0), np.arange(4)] > 0).all()


def test_channels_that_never_vary_are_constants() -> None:
    y = responses()
    y[:, 2] = 1.5
    low = approximate(y, y, 8)
    np.testing.assert_allclose(low(y), y, atol=1e-9)
    assert low.reduce.shape == (8, 8)
    flat = np.full((100, 3), 0.25)
    np.testing.assert_allclose(approximate(flat, flat, 2)(flat), flat)


def test_the_two_kernels_are_the_kernel_and_the_map() -> None:
    rng = np.random.default_rng(6)
    kernel, bias = rng.standard_normal((8, 3, 3, 3)), rng.standard_normal(8)
    patches = rng.standard_normal((500, 27))
    y = patches @ kernel.reshape(8, -1).T + bias
    low = approximate(y, y, 3)
    first, shift, second, offset = low.kernels(kernel, bias)
    assert (first.shape, second.shape) == ((3, 3, 3, 3), (8, 3, 1, 1))
    found = (patches @ first.reshape(3, -1).T + shift) @ second[:, :, 0, 0].T + offset
    np.testing.assert_allclose(found, low(y), atol=1e-9)
