"""Convolutions in low rank against brute force: exact at full rank, and nearest of all maps of a rank."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from elf_export.compression.low_rank import LowRank, approximate, principal, spectrum

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


def loss(low: LowRank, wanted: Rows, given: Rows) -> float:
    return float(np.square(low(given) - wanted).mean())


@pytest.mark.parametrize("balance", [0.0, 0.5, 1.0])
def test_full_rank_is_exact(balance: float) -> None:
    y = responses()
    gradients = np.cov(responses(9).T)
    for low in (approximate(y, y, 8, balance), principal(y, 8, None, balance), principal(y, 8, gradients, balance)):
        np.testing.assert_allclose(low(y), y, atol=1e-9)


@pytest.mark.parametrize("rank", [1, 3, 7])
def test_of_a_network_that_is_whole_before_it_is_the_principal_components(rank: int) -> None:
    """Eckart and Young: what is lost are the smallest singular values of the centred responses."""
    y = responses()
    centred = y - y.mean(axis=0)
    u, s, vt = np.linalg.svd(centred, full_matrices=False)
    for low in (approximate(y, y, rank), principal(y, rank)):
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
    squares, products = a.T @ a, b.T @ a
    found = []
    for seed in range(3):
        v = np.random.default_rng(seed).standard_normal((rank, 8))
        for _ in range(100):
            u = products @ v.T @ np.linalg.inv(v @ squares @ v.T)  # (D, r): the best for this v
            v = np.linalg.pinv(u) @ products @ np.linalg.inv(squares)  # the best for this u
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


@pytest.mark.parametrize("rank", [1, 2, 5])
def test_no_other_projection_keeps_more_of_responses_and_gradients(rank: int) -> None:
    """Against random projections, and those that are the best for one of the two."""
    y, g = responses(), responses(9)
    c, d = np.cov(y.T, bias=True), g.T @ g / len(g)

    def lost(u: np.ndarray) -> float:
        rest = np.eye(8) - u @ u.T
        return float(np.trace(rest @ c) / np.trace(c) + np.trace(rest @ d) / np.trace(d))

    low = principal(y, rank, 7 * d, balance=0.0)  # however large the gradients are
    np.testing.assert_allclose(low.expand.T @ low.expand, np.eye(rank), atol=1e-9)
    np.testing.assert_allclose(low.reduce, low.expand.T, atol=1e-9)
    others = [np.linalg.eigh(m)[1][:, -rank:] for m in (c, d)]
    others += [np.linalg.qr(np.random.default_rng(k).standard_normal((8, rank)))[0] for k in range(50)]
    assert lost(low.expand) < min(map(lost, others))


@pytest.mark.parametrize("balance", [0.0, 0.5, 1.0])
def test_balance_evens_the_middle_and_changes_no_value(balance: float) -> None:
    y = responses()
    low = principal(y, 4, balance=balance)
    np.testing.assert_allclose(low(y), approximate(y, y, 4, 0.0)(y), atol=1e-9)
    middle = y @ low.reduce.T + low.shift
    np.testing.assert_allclose(middle.mean(axis=0), 0, atol=1e-9)
    back = cv2.dct(np.eye(4), flags=cv2.DCT_ROWS).T  # from the turned channels to the components
    np.testing.assert_allclose((middle @ back.T).std(axis=0), np.sqrt(spectrum(y)[:4]) ** (1 - balance), rtol=1e-6)
    expand = low.expand @ back.T
    assert (expand[np.abs(expand).argmax(axis=0), np.arange(4)] > 0).all()
    assert np.ptp(middle.std(axis=0)) <= np.ptp((middle @ back.T).std(axis=0)) + 1e-9


def test_channels_that_never_vary_are_constants() -> None:
    y = responses()
    y[:, 2] = 1.5
    low = approximate(y, y, 8)
    np.testing.assert_allclose(low(y), y, atol=1e-9)
    assert low.reduce.shape == (8, 8)
    flat = np.full((100, 3), 0.25)
    for found in (approximate(flat, flat, 2), principal(flat, 2)):
        np.testing.assert_allclose(found(flat), flat)


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
