"""Structure from motion from few images: the second task of the Image Matching challenge of 2019.

COLMAP places a subset of a scene's images by a method's matches, with intrinsics given.  The relative pose of every two
images of the subset is held against the true one, which comes from the whole scene.  Needs pycolmap, the extra ``sfm``.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from elf_eval.coordinates import Float
from elf_eval.data import Pair
from elf_eval.data.images import ImageRef
from elf_eval.data.truth import Pose
from elf_eval.errors import EvalError
from elf_eval.features import ImageFeatures
from elf_eval.metrics.matching import descriptor_distances, mutual_nearest
from elf_eval.metrics.pose import pose_error
from elf_eval.protocol import Protocol
from elf_runtime import ElfError
from elf_runtime.pictures.file import write_picture
from elf_runtime.reconstruction import Calibration, Camera, Model, map_database, write_database

from .refinement import as_runtime
from .subsets import Subset

THREADS = 1  # of the mapper: on several, which pair of images it begins with depends on their timing

Truths = Mapping[tuple[ImageRef, ImageRef], Pair]


@dataclass(frozen=True)
class Reconstruction:
    """What came of one subset.

    Attributes
    ----------
    errors : list of float
        Degrees, of each pair of the subset whose true pose is known; infinite where one of its images was not placed.
    placed : int
        Images.
    points : int
    track_length : float
        Images that see a point, on average; 0 without points.
    keypoints : list of int
        Of each image.
    """

    scene: str
    images: tuple[str, ...]
    errors: list[float]
    placed: int
    points: int
    track_length: float
    keypoints: list[int]


def reconstruct(
    subset: Subset, features: Mapping[ImageRef, ImageFeatures], truths: Truths, protocol: Protocol
) -> Reconstruction:
    """Place the images of a subset by their features, and measure the relative poses.

    The same input gives the same result.

    Raises
    ------
    EvalError
        If pycolmap is not there, or refuses a camera.
    """
    names = {ref: f"{number:03d}.png" for number, ref in enumerate(subset)}
    known = [pair for a, b in combinations(subset, 2) if (pair := truths.get((a, b)) or truths.get((b, a)))]
    cameras = _cameras(known, features, names)
    model = _model(subset, features, cameras, names, protocol)
    errors = [_error(pair, features, model, names) for pair in known]
    points, length = (len(model.xyz), model.track_length) if model else (0, 0.0)
    counts = [len(features[ref].features.keypoints) for ref in subset]
    placed = len(model.poses) if model else 0
    images = tuple(ref.name for ref in subset)
    return Reconstruction(known[0].scene, images, errors, placed, points, length, counts)


def _pose(pair: Pair, features: Mapping[ImageRef, ImageFeatures]) -> Pose:
    found = pair.truth.at(features[pair.first].to_working, features[pair.second].to_working).pose
    if found is None:
        raise EvalError(f"{pair.name}: its poses are not known; structure from motion needs a dataset that has them")
    return found


def _cameras(
    pairs: Sequence[Pair], features: Mapping[ImageRef, ImageFeatures], names: Mapping[ImageRef, str]
) -> dict[str, Camera]:
    """Each image's own, of the working size."""
    matrices: dict[ImageRef, Float] = {}
    for pair in pairs:
        pose = _pose(pair, features)
        matrices |= {pair.first: pose.camera1, pair.second: pose.camera2}
    cameras = {}
    for ref, matrix in matrices.items():
        width, height = features[ref].size
        upper = np.array(matrix / matrix[2, 2])
        upper[0, 1] = 0.0  # COLMAP has no skew; of resized images it is below a thousandth
        cameras[names[ref]] = Camera.calibrated((height, width), Calibration.of_matrix(upper))
    return cameras


def _model(
    subset: Subset,
    features: Mapping[ImageRef, ImageFeatures],
    cameras: Mapping[str, Camera],
    names: Mapping[ImageRef, str],
    protocol: Protocol,
) -> Model | None:
    """The largest model; None where no two images could be placed."""
    described = {ref: features[ref].features.descriptors for ref in subset}
    matches = {
        (names[a], names[b]): mutual_nearest(descriptor_distances(described[a], described[b]), protocol.ratio)
        for a, b in combinations(subset, 2)
    }
    with tempfile.TemporaryDirectory(prefix="elf-eval-") as folder:
        for ref in subset:
            write_picture(Path(folder, names[ref]), ref.open(protocol.size).pixels)
        database = Path(folder, "database.db")
        try:
            write_database(database, {names[ref]: as_runtime(features[ref]) for ref in subset}, matches, cameras)
        except ElfError as error:
            raise EvalError(f"{subset[0].name}: {error}") from error
        try:
            return map_database(database, folder, folder, refine=False, threads=THREADS)[0]
        except ElfError:
            return None  # nothing could be placed: every error is infinite


def _error(
    pair: Pair, features: Mapping[ImageRef, ImageFeatures], model: Model | None, names: Mapping[ImageRef, str]
) -> float:
    one, two = names[pair.first], names[pair.second]
    if model is None or one not in model.poses or two not in model.poses:
        return math.inf
    a, b = model.poses[one], model.poses[two]
    rotation = b.rotation @ a.rotation.T
    true = _pose(pair, features)
    return pose_error((rotation, b.translation - rotation @ a.translation), true.rotation, true.translation)
