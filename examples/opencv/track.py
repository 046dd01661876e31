"""Follow a plane through a video with OpenCV: features, matches to the first frame, a homography.

    python examples/opencv/track.py VIDEO [PICTURES]

VIDEO is what cv2.VideoCapture opens: a file, or frames as frame%03d.png.  Prints the matches and inliers of each frame
and where its centre lay in the first one; writes the matches of each frame to the folder PICTURES.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from elf_runtime import ElfFeature2D

detector = ElfFeature2D(max_keypoints=500)  # in place of cv2.SIFT_create(500)
matcher = cv2.BFMatcher(detector.defaultNorm())


def matched(first: np.ndarray, now: np.ndarray) -> list[cv2.DMatch]:
    """The matches that pass Lowe's ratio test."""
    pairs = matcher.knnMatch(first, now, k=2)
    return [best for best, second in pairs if best.distance < 0.9 * second.distance]


def main() -> int:
    video, folder = cv2.VideoCapture(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None
    there, frame = video.read()
    if not there:
        print(f"{sys.argv[1]}: no video", file=sys.stderr)
        return 1
    first = frame
    keypoints, descriptors = detector.detectAndCompute(first, None)
    centre = np.float32([[[first.shape[1] / 2, first.shape[0] / 2]]])
    number = 0
    while there:
        points, rows = detector.detectAndCompute(frame, None)
        found = [] if rows is None or descriptors is None or len(rows) < 2 else matched(descriptors, rows)
        homography, inliers = None, None
        if len(found) >= 4:
            a = np.float32([keypoints[m.queryIdx].pt for m in found])
            b = np.float32([points[m.trainIdx].pt for m in found])
            homography, inliers = cv2.findHomography(b, a, cv2.USAC_MAGSAC, 2.0)
        where = "lost"
        if homography is not None:
            x, y = cv2.perspectiveTransform(centre, homography)[0, 0]
            where = f"{int(inliers.sum())} inliers, centre at {x:.1f} {y:.1f}"
        print(f"frame {number}: {len(points)} keypoints, {len(found)} matches, {where}")
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            kept = None if inliers is None else inliers.ravel().tolist()
            drawn = cv2.drawMatches(first, keypoints, frame, points, found, None, matchesMask=kept)
            cv2.imwrite(str(folder / f"frame{number:03d}.png"), drawn)
        number, (there, frame) = number + 1, video.read()
    return 0


if __name__ == "__main__":
    sys.exit(main())
