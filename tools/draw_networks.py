"""Draws docs/images/networks.jpg: the saliency of each model on the demo's photograph, with keypoints.

    elf-export --net vgg --layer pool2 --desc none -o vgg.onnx        # and the others
    python tools/draw_networks.py vgg.onnx alexnet.onnx ... [--out docs/images/networks.jpg]

The settings are those of the preset "paper".
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from elf_runtime import ElfRuntime, Features
from elf_runtime.pictures.canvas import Picture, circle, side_by_side, stacked, titled
from elf_runtime.pictures.render import heatmap

ROOT = Path(__file__).resolve().parent.parent
COLUMNS, WIDTH = 4, 424
RING = (235, 225, 140)


def reduced(picture: Picture) -> Picture:
    height = round(WIDTH * picture.shape[0] / picture.shape[1])
    return np.asarray(cv2.resize(picture, (WIDTH, height), interpolation=cv2.INTER_AREA), np.uint8)


def ringed(saliency: Picture, features: Features) -> Picture:
    """A small picture of the saliency, which has the image's size, and rings where the keypoints are."""
    picture = reduced(saliency)
    scale = WIDTH / features.image_size[1]
    for x, y in (features.keypoints + 0.5) * scale - 0.5:
        circle(picture, float(x), float(y), 4.0, RING, 1)
    return picture


def panel(model: Path, photograph: Picture) -> Picture:
    elf = ElfRuntime(model, threads=1)
    trace = elf.trace(photograph, preset="paper")
    saliency = cv2.resize(heatmap(trace.saliency), photograph.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    name = f"{elf.contract.network} {elf.contract.layer}"
    return titled(ringed(np.asarray(saliency, np.uint8), trace.features), name, f"{len(trace.features)} keypoints")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="+", type=Path, metavar="MODEL")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "networks.jpg")
    args = parser.parse_args()
    photograph = np.asarray(cv2.imread(str(ROOT / "demo" / "palace.jpg")), np.uint8)
    panels = [panel(model, photograph) for model in args.models] + [titled(reduced(photograph), "the photograph")]
    rows = [side_by_side(panels[i : i + COLUMNS]) for i in range(0, len(panels), COLUMNS)]
    cv2.imwrite(str(args.out), stacked(rows), [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()
