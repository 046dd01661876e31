"""A convolution in low rank, in closed form.

The responses of a convolution k x k of C to D channels, y = W x + b of each place's patch x, are projected to r
dimensions.  Both are linear, so together they are two convolutions: k x k of C to r channels, then 1 x 1 of r to D.
After Zhang, Zou, He, Sun, "Accelerating very deep convolutional networks for classification and detection", TPAMI
2015: section 3.1 (responses), 3.2 (ReLUs), 3.3 (asymmetric reconstruction).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array64 = npt.NDArray[np.float64]

LEAST_VARIANCE = 1e-9  # of the largest: directions below it are left out of a regression
# Of the alternation for ReLUs: how strongly the auxiliary responses are held to the approximation, and how often.
HELD = ((0.01, 25), (1.0, 25))


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
    wanted: npt.NDArray[np.floating], given: npt.NDArray[np.floating], rank: int, balance: float = 0.5
) -> LowRank:
    """The affine map of rank `rank` that takes `given` nearest to `wanted`, in the sum of squares.

    Reduced-rank regression: of the least-squares map M of the centred responses, the part in the first r principal
    directions U of what it predicts, U U^T M.  Where both are the same responses that is their principal components,
    y ~ mean + U U^T (y - mean).  Otherwise it is Zhang's asymmetric reconstruction, section 3.3: `given` are the
    responses in the network as compressed so far, whose errors the map makes good again.

    Parameters
    ----------
    wanted, given : (n, D)
        Responses of the same convolution at the same places.
    rank : int
        1 to D.
    balance : float in [0, 1]
        The middle's channels are divided by their standard deviation to that power, and what reads them makes up for
        it: the values are the same, but their ranges become alike, which 8 bits keep better.  A channel's sign makes
        its largest coefficient in `expand` positive, so that the same responses give the same map.
    """
    y, x = np.asarray(wanted, np.float64), np.asarray(given, np.float64)
    mean_y, mean_x = y.mean(axis=0), x.mean(axis=0)
    y, x = y - mean_y, x - mean_x
    values, vectors = np.linalg.eigh(x.T @ x / len(x))
    kept = values > LEAST_VARIANCE * max(values[-1], 0.0)
    white = vectors[:, kept] / np.sqrt(values[kept])  # (D, q): x @ white has unit covariance
    predicted = (y.T @ x / len(x)) @ white  # (D, q): y ~ predicted @ (white^T x)
    u, s, vt = np.linalg.svd(predicted, full_matrices=False)
    found = min(rank, len(s))
    u, s, vt = u[:, :found], s[:found], vt[:found]
    signs = np.sign(u[np.abs(u).argmax(axis=0), np.arange(found)])
    u = u * signs
    reduce = (signs * s)[:, None] * vt @ white.T  # (r, D): U^T M
    scale = np.maximum(s, 1e-6 * s.max(initial=1e-300)) ** balance
    reduce, expand = reduce / scale[:, None], u * scale
    if found < rank:
        reduce, expand = np.pad(reduce, [(0, rank - found), (0, 0)]), np.pad(expand, [(0, 0), (0, rank - found)])
    return LowRank(reduce, -reduce @ mean_x, expand, mean_y)


def approximate_rectified(
    wanted: npt.NDArray[np.floating], given: npt.NDArray[np.floating], rank: int, balance: float = 0.5
) -> LowRank:
    """As `approximate`, nearest to `wanted` behind a ReLU: min sum |max(y, 0) - max(M y' + b, 0)|^2.

    Zhang's relaxation, section 3.2: auxiliary responses z for min sum |max(y, 0) - max(z, 0)|^2 + l |z - (M y' + b)|^2,
    in which z, place by place, and (M, b), by `approximate`, take turns while l grows.
    """
    rectified = np.maximum(np.asarray(wanted, np.float64), 0.0)
    found = approximate(wanted, given, rank, balance)
    for held, rounds in HELD:
        for _ in range(rounds):
            found = approximate(_between(rectified, found(given), held), given, rank, balance)
    return found


def _between(rectified: Array64, near: Array64, held: float) -> Array64:
    """z that minimises (rectified - max(z, 0))^2 + held (z - near)^2: the better of one below 0 and one above."""
    below = np.minimum(near, 0.0)
    above = np.maximum((held * near + rectified) / (held + 1.0), 0.0)
    cost_below = rectified**2 + held * (below - near) ** 2
    cost_above = (rectified - above) ** 2 + held * (above - near) ** 2
    return np.where(cost_below < cost_above, below, above)
