"""A second view of a photograph, to match against: tilted and turned, darker, with blur and noise.

python demo/second_view.py demo/palace.jpg out/demo/view.png
"""

from __future__ import annotations

import argparse
import sys

import cv2
import numpy as np


def second_view(image: np.ndarray) -> np.ndarray:
    """`image` (H, W, 3) uint8 under a fixed homography and fixed changes of light and sharpness."""
    height, width = image.shape[:2]
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    moved = corners + np.array([[0.10, 0.14], [-0.16, -0.04], [-0.05, -0.12], [0.02, 0.06]]) * [width, height]
    warped = cv2.warpPerspective(
        image, cv2.getPerspectiveTransform(corners, moved.astype(np.float32)), (width, height),
        borderMode=cv2.BORDER_REFLECT,
    )  # fmt: skip
    soft = cv2.GaussianBlur(warped, (0, 0), 1.0).astype(np.float32)
    noise = np.random.default_rng(1).normal(0, 6, soft.shape)
    return np.clip(0.75 * soft + noise, 0, 255).astype(np.uint8)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", help="photograph")
    parser.add_argument("target", help="image file of the view")
    args = parser.parse_args()
    source, target = args.source, args.target
    image = cv2.imread(source)
    if image is None or not cv2.imwrite(target, second_view(image)):
        print(f"second_view: error: can't read {source} or write {target}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
