"""Shorter descriptors: an affine map of a layer's channels, fitted to what the layer gives on photographs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import onnx

from elf_export.calibration import CalibrationSet
from elf_export.errors import LayerError
from elf_export.saliency import descriptor_output
from elf_runtime import InputSpec
from elf_runtime.contract import ReductionSpec
from elf_runtime.model.session import open_session

Array64 = npt.NDArray[np.float64]

METHODS = ("pca", "channels")
WHITEN = 0.75
MOST_CELLS = 20_000  # of one image's map
LEAST_VARIANCE = 1e-6  # of the largest: below it, whitening would blow float32's rounding up to be seen


@dataclass(frozen=True)
class Reduction:
    """What is asked for.

    Attributes
    ----------
    dim : int
        Values of a descriptor.
    method : "pca" or "channels"
        The directions of the largest variance, or the channels of the largest variance.
    whiten : float in [0, 1], optional
        Each principal component is divided by its variance to the power of whiten / 2: 0 keeps distances, 1
        makes all variances the same.  By default 0.75, which matched best of VGG's layers on Oxford's images.
    separate : bool
        Project by a convolution of its own, and leave the layer's weights in the file as they were trained.
    """

    dim: int
    method: str = "pca"
    whiten: float | None = None
    separate: bool = False

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise LayerError(f"descriptors are reduced by {' or '.join(METHODS)}, not by {self.method!r}")
        if self.dim < 1:
            raise LayerError(f"a descriptor has at least 1 value, not {self.dim}")
        if not 0.0 <= self.exponent <= 1.0:
            raise LayerError(f"the exponent of whitening is a number in [0, 1], not {self.exponent:g}")
        if self.whiten and self.method != "pca":
            raise LayerError("whitening divides principal components; it goes with pca only")

    @property
    def exponent(self) -> float:
        """`whiten`, or what stands for it where it is not given."""
        if self.whiten is not None:
            return float(self.whiten)
        return WHITEN if self.method == "pca" else 0.0

    def words(self) -> list[str]:
        """The options of `elf-export` that say the same."""
        words = ["--desc-dim", str(self.dim)]
        words += ["--desc-reduce", self.method] if self.method != "pca" else []
        words += ["--keep-weights"] if self.separate else []
        return words + (["--whiten", str(self.exponent)] if self.method == "pca" else [])


@dataclass(frozen=True)
class Projection:
    """y = (x - mean) @ matrix, of each cell's channels.

    Attributes
    ----------
    mean : (D,) float64
    matrix : (D, d) float64
    kept : float
        Share of the variance over the calibration set that lies in the d directions or channels.
    """

    mean: Array64
    matrix: Array64
    kept: float

    def __call__(self, maps: npt.NDArray[np.floating]) -> Array64:
        """(..., D) -> (..., d), in float64."""
        return np.asarray((np.asarray(maps, np.float64) - self.mean) @ self.matrix)


def fit(cells: Iterable[npt.NDArray[np.floating]], reduction: Reduction) -> Projection:
    """The projection for what a layer gives.

    Principal components of the cells as they are, not scaled to unit length: fitted so the map is affine, and
    sampling between cells and projecting can change places.  A component's sign is arbitrary; its largest
    coefficient is made positive, so that the same cells give the same matrix.  Channels are taken in the
    order of their variance as well, and not centred.

    Parameters
    ----------
    cells : arrays (n, D), finite
        One or more; read once.

    Raises
    ------
    LayerError
        If there are fewer than `reduction.dim` channels, or channels that vary.
    """
    mean, covariance = moments(cells)
    total = float(np.trace(covariance))
    if reduction.dim > len(mean):
        raise LayerError(f"it has {len(mean)} channels, fewer than the {reduction.dim} asked for")
    if reduction.method == "channels":
        variance = np.diag(covariance)
        chosen = np.argsort(-variance, kind="stable")[: reduction.dim]
        matrix = np.eye(len(mean))[:, chosen]
        return Projection(np.zeros(len(mean)), matrix, float(variance[chosen].sum()) / max(total, 1e-300))
    values, vectors = np.linalg.eigh(covariance)
    variance, vectors = values[::-1][: reduction.dim], vectors[:, ::-1][:, : reduction.dim]
    if variance[-1] <= LEAST_VARIANCE * variance[0]:
        rank = int((variance > LEAST_VARIANCE * variance[0]).sum())
        raise LayerError(
            f"its channels vary in {rank} directions over the calibration images, fewer than the {reduction.dim} "
            "asked for"
        )
    largest = np.abs(vectors).argmax(axis=0)
    vectors = vectors * np.sign(vectors[largest, np.arange(reduction.dim)])
    scale = (variance / variance[0]) ** (-reduction.exponent / 2)
    return Projection(mean, vectors * scale, float(variance.sum()) / total)


def moments(cells: Iterable[npt.NDArray[np.floating]]) -> tuple[Array64, Array64]:
    """Mean (D,) and covariance (D, D) of all rows of some (n, D) arrays, in float64.

    Batches are merged as in Chan, Golub, LeVeque, "Updating formulae and a pairwise algorithm for computing
    sample variances", 1979: with d the difference of two means, the sums of squares add up to
    M_a + M_b + d d^T n_a n_b / (n_a + n_b).
    """
    count, mean, squares = 0, np.zeros(0), np.zeros((0, 0))
    for batch in cells:
        rows = np.asarray(batch, np.float64)
        if count == 0:
            mean, squares = np.zeros(rows.shape[1]), np.zeros((rows.shape[1],) * 2)
        if len(rows) == 0:
            continue
        center = rows.mean(axis=0)
        rows = rows - center
        shift, both = center - mean, count + len(rows)
        squares += rows.T @ rows + np.outer(shift, shift) * (count * len(rows) / both)
        mean = mean + shift * (len(rows) / both)
        count = both
    return mean, squares / max(count - 1, 1)


def fit_layers(
    model: onnx.ModelProto,
    layers: Sequence[str],
    reduction: Reduction,
    images: CalibrationSet,
    spec: InputSpec,
    scale: float,
) -> dict[str, Projection]:
    """A projection of each descriptor layer, fitted to its map of every calibration image.

    Parameters
    ----------
    model : onnx.ModelProto
        With the outputs ``descriptors_NAME`` (N, h, w, D).
    layers : names
        As in the contract.
    scale : float
        Working scale at which the network will see images.

    Returns
    -------
    dict
        Layer -> Projection.

    Raises
    ------
    LayerError
        Naming the layer that does not have so many channels, or gives no finite values.
    """
    outputs = {layer: descriptor_output(layer) for layer in layers}
    session, _ = open_session(model.SerializeToString())
    cells: dict[str, list[npt.NDArray[np.float32]]] = {layer: [] for layer in layers}
    for pixels in images.batches(spec, scale):
        maps = session.run(list(outputs.values()), {spec.name: pixels})
        for layer, found in zip(layers, maps, strict=True):
            if not np.isfinite(found).all():
                raise LayerError(f"{layer!r} gives values that are not finite; it can't be reduced")
            cells[layer].append(thinned(found[0]))
    projections = {}
    for layer in layers:
        try:
            projections[layer] = fit(cells[layer], reduction)
        except LayerError as error:
            raise LayerError(f"{layer!r} can't be reduced: {error}") from None
    return projections


def thinned(cells: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """A map's cells as rows, every k-th along both axes where it has too many.  (h, w, D) -> (n, D)."""
    step = int(np.ceil(np.sqrt(cells.shape[0] * cells.shape[1] / MOST_CELLS)))
    return cells[::step, ::step].reshape(-1, cells.shape[2])


def specs(
    projections: Mapping[str, Projection], reduction: Reduction, images: CalibrationSet
) -> dict[str, ReductionSpec]:
    """What the contract says of each layer's projection."""
    return {
        layer: ReductionSpec(
            method=reduction.method,
            source_dim=len(projection.mean),
            whiten=reduction.exponent,
            kept=projection.kept,
            calibration=images.name,
            sha256=images.sha256,
        )
        for layer, projection in projections.items()
    }
