"""Where a new image was taken: its pose in a model, by matches with the model's images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import SettingError
from elf_runtime.results.features import Features
from elf_runtime.results.matches import Matches

from .cameras import Camera
from .database import HALF, colmap_camera
from .library import SEED, quiet
from .model import Float, Model, Pose

FEWEST = 12  # inliers; chance hardly gives as many


@dataclass(frozen=True, eq=False)
class Localization:
    """Where an image was taken.

    Attributes
    ----------
    pose : Pose
        From the model's world to the camera.
    camera : Camera
        What the pose was found with; its focal length is estimated where it was not known.
    matches : int
        Keypoints that match one which shows a point of the model.
    inliers : int
        Those that the pose explains.
    reprojection_error : float
        Of the inliers, in pixels: the median.
    """

    pose: Pose
    camera: Camera
    matches: int
    inliers: int
    reprojection_error: float


def localize(
    model: Model,
    known: Mapping[str, Features],
    features: Features,
    camera: Camera | None = None,
    *,
    ratio: float | None = 0.9,
    threshold: float = 4.0,
) -> Localization | None:
    """Place an image in a model.

    Its features are matched with those of every image of the model, the keypoints that show points give pairs of a
    pixel and a point, and the pose is estimated from these (P3P in LO-RANSAC) and refined.

    Parameters
    ----------
    model : Model
    known : mapping
        Name -> the features that the model was made of; at least of its images.
    features : Features
        Of the new image, of the same detector and settings, in its pixels as stored.
    camera : Camera, optional
        By default the model's own for images of this size: the one whose images match best, where there are several.
        Where there is none, one whose focal length is estimated too.
    ratio : float, optional
        Of Lowe's test, as in `Matches.between`.
    threshold : float
        Largest reprojection error of an inlier, in pixels.

    Returns
    -------
    Localization or None
        None where no pose explains 12 matches.

    Raises
    ------
    ElfError
        If pycolmap is not there.
    SettingError
        If the descriptors are of other lengths, `known` lacks an image of the model, or COLMAP does not take the
        camera.
    """
    if missing := [name for name in model.tracks if name not in known]:
        more = f" and {len(missing) - 1} more of the model's images" if len(missing) > 1 else ", an image of the model"
        raise SettingError(f"there are no features of {missing[0]}{more}")
    pixels, rows, votes = _correspondences(model, known, features, ratio)
    if camera is None:
        camera = _most_likely(votes, features.image_size)
    if len(pixels) < FEWEST:
        return None
    with quiet() as colmap:
        made = colmap_camera(colmap, camera)
        found = _estimated(colmap, made, pixels, model.xyz[rows], threshold)
        if found is None or int(found["num_inliers"]) < FEWEST:
            return None
        inliers = np.asarray(found["inlier_mask"], np.bool_)
        seen = [found["cam_from_world"] * point for point in model.xyz[rows[inliers]]]
        errors = np.linalg.norm([made.img_from_cam(point) for point in seen] - pixels[inliers], axis=1)
        params = tuple(float(value) for value in made.params)
    return Localization(
        Pose.of_colmap(found["cam_from_world"]),
        Camera(camera.model, params, camera.image_size, True),
        len(pixels),
        int(inliers.sum()),
        float(np.median(errors)),
    )


def _estimated(colmap: Any, camera: Any, pixels: Float, points: Float, threshold: float) -> Any:
    """pycolmap's pose and inliers; an unknown focal length is written into the camera."""
    estimation, refinement = colmap.AbsolutePoseEstimationOptions(), colmap.AbsolutePoseRefinementOptions()
    estimation.ransac.max_error, estimation.ransac.random_seed = threshold, SEED
    estimation.estimate_focal_length = refinement.refine_focal_length = not camera.has_prior_focal_length
    return colmap.estimate_and_refine_absolute_pose(pixels, points, camera, estimation, refinement)


def _correspondences(
    model: Model, known: Mapping[str, Features], features: Features, ratio: float | None
) -> tuple[Float, npt.NDArray[np.int64], dict[Camera, int]]:
    """Pixels of the new image in COLMAP's convention, (M, 2), and rows of the model's points, (M,); no pair twice.

    The third is how many of them, counted for each image, the images of each camera gave.
    """
    pairs, votes = [np.zeros((0, 2), np.int64)], dict.fromkeys(model.cameras.values(), 0)
    for name, shown in model.tracks.items():
        new, old = Matches.between(features, known[name], ratio).indices.T
        seen = shown[old] >= 0
        pairs.append(np.stack([new[seen], shown[old[seen]]], axis=1))
        votes[model.cameras[name]] += int(seen.sum())
    found = np.unique(np.concatenate(pairs), axis=0)
    return features.keypoints[found[:, 0]].astype(np.float64) + HALF, found[:, 1], votes


def _most_likely(votes: Mapping[Camera, int], image_size: tuple[int, int]) -> Camera:
    fitting = [camera for camera in votes if camera.image_size == image_size]
    return max(fitting, key=lambda camera: votes[camera]) if fitting else Camera.guessed(image_size)
