"""Draws docs/images/pipeline.jpg: what becomes of the demo's photograph, from its pixels to descriptors.

    python tools/draw_figures.py [--out docs/images]

The steps are those of the bundled model's default, taken from `ElfRuntime.trace` and from the graph.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime import ElfRuntime, Features, Trace
from elf_runtime.pictures.canvas import Picture, side_by_side, titled
from elf_runtime.pictures.render import draw_keypoints, draw_mask, heatmap

ROOT = Path(__file__).resolve().parent.parent
PART = (slice(20, 260), slice(120, 440))  # rows and columns of the photograph that are shown
ZOOM = 1.6


def shown(picture: npt.NDArray[np.uint8], size: tuple[int, int]) -> Picture:
    """The part of a picture, which is brought to (height, width) of the photograph first, enlarged."""
    whole = cv2.resize(picture, size[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.resize(whole[PART], None, fx=ZOOM, fy=ZOOM, interpolation=cv2.INTER_CUBIC), np.uint8)


def part_of(features: Features) -> Picture:
    """The keypoints on the enlarged part."""
    rows, columns = PART
    points = (features.keypoints - (columns.start, rows.start) + 0.5) * ZOOM - 0.5
    height, width = (round((side.stop - side.start) * ZOOM) for side in PART)
    image = cv2.imread(str(ROOT / "demo" / "palace.jpg"))[PART]
    view = cv2.resize(image, (width, height), interpolation=cv2.INTER_CUBIC)
    inside = (points >= 0).all(1) & (points < (width, height)).all(1)
    moved = Features(
        keypoints=points[inside].astype(np.float32),
        scores=features.scores[inside],
        descriptors=features.descriptors[inside],
        image_size=(height, width),
        nms_radius=features.nms_radius,
        sizes=features.sizes[inside],
    )
    return draw_keypoints(view, moved)


def descriptors_as_colors(elf: ElfRuntime, image: npt.NDArray[np.uint8]) -> Picture:
    """The descriptor of each fourth pixel, its three principal components as blue, green and red."""
    height, width = image.shape[:2]
    ys, xs = np.mgrid[2:height:4, 2:width:4]
    rows = elf.describe(image, np.stack([xs.ravel(), ys.ravel()], 1).astype(np.float32))
    centred = rows - rows.mean(0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    values = centred @ (axes[:, :-4:-1] * np.sign(axes[0, :-4:-1]))
    low, high = np.quantile(values, (0.01, 0.99), axis=0)
    colors = (np.clip((values - low) / (high - low), 0, 1) * 255).astype(np.uint8)
    return np.asarray(colors.reshape(*xs.shape, 3), np.uint8)


def pipeline(elf: ElfRuntime, image: npt.NDArray[np.uint8]) -> Picture:
    """Two rows of three panels."""
    trace: Trace = elf.trace(image)
    size = image.shape[:2]
    share = 100 * float(trace.mask.mean())
    panels = [
        titled(shown(image, size), "1  image I"),
        titled(shown(heatmap(trace.saliency), size), "2  saliency S = |F^T dF/dI|"),
        titled(shown(heatmap(trace.scores), size), "3  blurred: the scores"),
        titled(shown(draw_mask(image, trace.mask), size), f"4  Kapur's level: {share:.0f} % pass"),
        titled(part_of(trace.features), f"5  maxima: {len(trace.features)} keypoints in all"),
        titled(shown(descriptors_as_colors(elf, image), size), "6  descriptors, as colours"),
    ]
    return np.concatenate([side_by_side(panels[:3]), side_by_side(panels[3:])])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="folder of the pictures")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    picture = pipeline(ElfRuntime(threads=1), cv2.imread(str(ROOT / "demo" / "palace.jpg")))
    cv2.imwrite(str(out / "pipeline.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()
