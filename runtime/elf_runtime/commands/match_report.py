"""What elf-match says and writes of a pair: a line, a part of the JSON, arrays and a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.files.write import write_atomically
from elf_runtime.geometry.two_view import TwoView
from elf_runtime.pictures.file import short_name, write_picture
from elf_runtime.pictures.render import match_picture
from elf_runtime.results.features import Array, Features

from .match_cameras import Float


@dataclass(frozen=True, eq=False)
class Matched:
    """A pair of images that are matched.

    Attributes
    ----------
    first, second : Features
    pairs : (M, 2) int64
        Into these.
    points : two (M, 2)
        Where the matches are, (x, y) in pixels of the two images: keypoints, or the second ones as refined.
    refined : int, optional
        How many of the second ones were moved; None where that was not asked for.
    view : TwoView, optional
        Where a geometry was asked for.
    cameras : two (3, 3), optional
        Of an essential matrix.
    """

    first: Features
    second: Features
    pairs: npt.NDArray[np.int64]
    points: tuple[Array, Array]
    refined: int | None
    view: TwoView | None
    cameras: tuple[Float, Float] | None

    @property
    def supported(self) -> TwoView | None:
        """The geometry, where the matches support one."""
        return self.view if self.view is not None and self.view.supported else None

    def counts(self) -> str:
        """Such as "335 matches, 271 homography inliers"; with the refined ones, "335 matches (302 refined), ..."."""
        text = f"{len(self.pairs)} matches" + ("" if self.refined is None else f" ({self.refined} refined)")
        if self.view is None:
            return text
        inliers = int(self.view.inliers.sum())
        return f"{text}, {inliers} {self.view.kind} inliers" if self.view.supported else f"{text}, no {self.view.kind}"

    def more(self) -> str:
        """What follows the counts in a line: how many inliers there are at best, or by how much the camera turned."""
        if self.view is None or self.view.matrix is None:
            return ""
        if not self.view.supported:
            return f" that they support: {int(self.view.inliers.sum())} inliers at best, as chance would give"
        if self.view.rotation is None:
            return ""
        angle = np.degrees(np.linalg.norm(cv2.Rodrigues(self.view.rotation)[0]))
        return f", turned by {angle:.1f} degrees"

    def summary(self) -> dict[str, Any]:
        """What the JSON says of the pair."""
        view, given = self.view, self.supported
        return {
            "matches": len(self.pairs),
            "refined": self.refined,
            "supported": view.supported if view is not None else None,
            "inliers": int(view.inliers.sum()) if view is not None else None,
            "expected_by_chance": view.chance if view is not None and view.matrix is not None else None,
            "matrix": _plain(given.matrix if given else None),
            "rotation": _plain(given.rotation if given else None),
            "translation": _plain(given.translation if given else None),
            "K": [_plain(camera) for camera in self.cameras] if self.cameras else None,
        }

    def save(self, path: Path) -> None:
        """Write an ``.npz`` of the arrays that --help names."""
        view = self.supported
        arrays: dict[str, Any] = {"pairs": self.pairs}
        sides = zip("ab", (self.first, self.second), self.pairs.T, self.points, strict=True)
        for side, features, index, points in sides:
            arrays |= {f"points_{side}": points}
            arrays |= {f"{name}_{side}": getattr(features, name)[index] for name in ("scores", "sizes", "angles")}
        none = np.zeros(len(self.pairs), np.bool_)
        arrays["inliers"] = ~none if self.view is None else view.inliers if view else none
        arrays["matrix"] = _or_nan(view.matrix if view else None, (3, 3))
        if self.cameras is not None:
            arrays["rotation"] = _or_nan(view.rotation if view else None, (3, 3))
            arrays["translation"] = _or_nan(view.translation if view else None, (3,))
            arrays |= {"K_a": self.cameras[0], "K_b": self.cameras[1]}
        write_atomically(path, lambda temporary: np.savez_compressed(temporary, **arrays))

    def draw(self, path: Path, images: Sequence[npt.NDArray[Any]], names: Sequence[Path]) -> None:
        """Write the picture: inliers in green, other matches in thin red."""
        titles = [
            (short_name(names[0]), f"{len(self.first)} keypoints, {self.counts()}"),
            (short_name(names[1]), f"{len(self.second)} keypoints"),
        ]
        inliers = self.view.inliers & self.view.supported if self.view is not None else None
        write_picture(path, match_picture(list(images), self.points, inliers, titles))


def single_document(
    about: Sequence[Mapping[str, Any]], origin: Mapping[str, Any], settings: Mapping[str, Any], matched: Matched
) -> dict[str, Any]:
    """The JSON of two images: of each what that of many pairs has, and then what belongs to the pair."""
    return {"images": list(about), **origin, **settings, **matched.summary()}


def _plain(array: npt.NDArray[Any] | None) -> list[Any] | None:
    return None if array is None else array.tolist()


def _or_nan(array: npt.NDArray[Any] | None, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    return np.full(shape, np.nan) if array is None else array
