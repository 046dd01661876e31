"""A convolution in low rank, in closed form.

The responses of a convolution k x k of C to D channels, y = W x + b of each place's patch x, are projected to r
dimensions.  Both are linear, so together they are two convolutions: k x k of C to r channels, then 1 x 1 of r to D.
After Zhang, Zou, He, Sun, "Accelerating very deep convolutional networks for classification and detection", TPAMI
2015: section 3.1 (responses) and 3.3 (asymmetric reconstruction).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array64 = npt.NDArray[np.float64]

LEAST_VARIANCE = 1e-9  # of the largest: directions below it are left out of a regression
LEAST_DEVIATION = 1e-4  # of the largest, of a channel between the two convolutions
BALANCE = 0.5


@dataclass(frozen=True)
class LowRank:
    """y ~ expand (reduce y' + shift) + offset, with y' the responses of the same kernels to the network's input so far.

    Attributes
    ----------
    reduce : (r, D)
    shift : (r,)
        It centres what lies between the two convolutions.
    expand : (D, r)
    offset : (D,)
    """

    reduce: Array64
    shift: Array64
    expand: Array64
    offset: Array64

    def __call__(self, responses: npt.NDArray[np.floating]) -> Array64:
        """(n, D) -> (n, D)"""
        middle = np.asarray(responses, np.float64) @ self.reduce.T + self.shift
        return np.asarray(middle @ self.expand.T + self.offset)

    def kernels(
        self, kernel: npt.NDArray[np.floating], bias: npt.NDArray[np.floating]
    ) -> tuple[Array64, Array64, Array64, Array64]:
        """The two convolutions' kernels and biases: (r, C, k, k), (r,), (D, r, 1, 1), (D,).

        Parameters
        ----------
        kernel : (D, C, k, k)
        bias : (D,)
        """
        first = np.tensordot(self.reduce, np.asarray(kernel, np.float64), axes=1)
        return (
            first,
            self.reduce @ np.asarray(bias, np.float64) + self.shift,
            self.expand[:, :, None, None],
            self.offset,
        )


def spectrum(responses: npt.NDArray[np.floating]) -> Array64:
    """Variances of the responses' principal components, the largest first.  (n, D) -> (D,)"""
    rows = np.asarray(responses, np.float64)
    values = np.linalg.eigvalsh(np.atleast_2d(np.cov(rows.T, bias=True)))[::-1]
    return np.asarray(np.maximum(values, 0.0))


def approximate(
    wanted: npt.NDArray[np.floating], given: npt.NDArray[np.floating], rank: int, balance: float = BALANCE
) -> LowRank:
    """The affine map of rank `rank` that takes `given` nearest to `wanted`, in the sum of squares.

    Zhang's asymmetric reconstruction, section 3.3: `given` are the responses in the network as compressed so far, whose
    errors the map makes good again.  By reduced-rank regression: of the least-squares map M of the centred responses,
    the part in the first r principal directions U of what it predicts, U U^T M.  Where both are the same responses that
    is `principal` of them.

    Parameters
    ----------
    wanted, given : (n, D)
        Responses of the same convolution at the same places.
    rank : int
        1 to D.
    balance : float in [0, 1]
        The middle's channels are divided by their standard deviation to that power, and what reads them makes up for
        it: the values are the same, but their ranges become alike, which 8 bits keep better.
    """
    y, x = np.asarray(wanted, np.float64), np.asarray(given, np.float64)
    mean_y, mean_x = y.mean(axis=0), x.mean(axis=0)
    y, x = y - mean_y, x - mean_x
    values, vectors = np.linalg.eigh(x.T @ x / len(x))
    kept = values > LEAST_VARIANCE * max(values[-1], 0.0)
    whiten = vectors[:, kept] / np.sqrt(values[kept])  # (D, q)
    # y ~ P (whiten^T x), with P = (D, q); U^T M = diag(s) V^T whiten^T of P's singular values s and vectors.
    u, s, vt = np.linalg.svd((y.T @ x / len(x)) @ whiten, full_matrices=False)
    lack = rank - len(s)  # where fewer directions vary
    u, s, vt = u[:, :rank], s[:rank], vt[:rank]
    reduce = s[:, None] * vt @ whiten.T
    if lack > 0:
        u, s, reduce = np.pad(u, [(0, 0), (0, lack)]), np.pad(s, (0, lack)), np.pad(reduce, [(0, lack), (0, 0)])
    return _balanced(u, reduce, s, mean_x, mean_y, balance)


def principal(
    responses: npt.NDArray[np.floating], rank: int, gradients: Array64 | None = None, balance: float = BALANCE
) -> LowRank:
    """y ~ mean + U U^T (y - mean), with U (D, r) orthonormal.

    U spans the responses' first principal components; with `gradients`, those of responses and gradients together.
    The adjoint of the two convolutions is W^T U U^T g for W^T g, so that what U leaves out of the gradient g is lost on
    the way back, for the saliency.  Of the two moments, each divided by its trace, the sum is taken: of all orthonormal
    U, that keeps the largest shares of both together.

    Parameters
    ----------
    responses : (n, D)
    gradients : (D, D), optional
        Second moments of the gradients that come back to y, as `gradients.response_gradients` weighs them.
    """
    y = np.asarray(responses, np.float64)
    mean = y.mean(axis=0)
    y = y - mean
    moments = y.T @ y / len(y)
    vectors = np.linalg.eigh(_of_trace_one(moments) + (0.0 if gradients is None else _of_trace_one(gradients)))[1]
    u = vectors[:, ::-1][:, :rank]
    return _balanced(u, u.T, np.sqrt(np.maximum(np.einsum("ir,ij,jr->r", u, moments, u), 0.0)), mean, mean, balance)


def _of_trace_one(moments: Array64) -> Array64:
    return moments / max(float(np.trace(moments)), 1e-300)


def _balanced(
    expand: Array64, reduce: Array64, deviations: Array64, mean_x: Array64, mean_y: Array64, balance: float
) -> LowRank:
    """y ~ mean_y + expand reduce (x - mean_x), the middle's channels of these standard deviations made alike.

    They are then turned by the orthonormal cosine transform, whose rows have every channel in about equal shares: 8
    bits round all of them alike, and the strong ones no longer set the steps of the weak.  Before that a channel's sign
    makes its largest coefficient in `expand` positive, so that the same responses give the same map.
    """
    signs = np.sign(expand[np.abs(expand).argmax(axis=0), np.arange(expand.shape[1])])
    signs[signs == 0] = 1.0
    scale = signs * np.maximum(deviations, LEAST_DEVIATION * deviations.max(initial=1e-300)) ** balance
    turn = _cosine_transform(len(reduce))
    reduce, expand = turn @ (reduce / scale[:, None]), expand * scale @ turn.T
    return LowRank(reduce, -reduce @ mean_x, expand, mean_y)


def _cosine_transform(n: int) -> Array64:
    """The orthonormal discrete cosine transform (type III): (n, n)."""
    at, frequency = np.arange(n)[:, None], np.arange(n)
    turn = np.sqrt(2 / n) * np.cos(np.pi * (2 * at + 1) * frequency / (2 * n))
    turn[:, 0] = np.sqrt(1 / n)
    return np.asarray(turn)
