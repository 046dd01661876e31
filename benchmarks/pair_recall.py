"""How many of the images that show the same a global descriptor finds: what `elf-match --pairs nearest:N` goes by.

    python benchmarks/pair_recall.py --sequences data/oxford_affine --chosen-on bark,bikes,graf,leuven \\
        --scene data/strecha/entry-P10

In a folder of sequences each image is to find the others of its own sequence among all images.  In a scene with true
cameras (Strecha's layout) it is to find the K images that share most of its view: the share of the points, triangulated
from SIFT's matches along the true epipolar lines, that the other image has within its frame and sees from a direction
less than 30 degrees away.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from elf_eval.data.strecha import read_camera
from elf_runtime import ElfRuntime, Features, global_descriptor
from elf_runtime.commands.inputs import IMAGE_SUFFIXES
from elf_runtime.results.global_descriptor import nearest

Float = npt.NDArray[np.float64]
_WITHIN = np.cos(np.radians(30))


@dataclass(frozen=True)
class Seen:
    """An image of a sequence, what it shows, and its keypoints."""

    sequence: str
    pixels: npt.NDArray[np.uint8]
    features: Features


def color_histogram(seen: Seen) -> npt.NDArray[np.floating]:
    """The baseline: roots of the shares of 8 x 8 x 8 colours."""
    counts = cv2.calcHist([seen.pixels], [0, 1, 2], None, [8] * 3, [0, 256] * 3).ravel()
    return np.sqrt(counts / counts.sum())


POOLED: Mapping[str, Callable[[Seen], npt.NDArray[np.floating]]] = {
    "`global_descriptor`": lambda seen: global_descriptor(seen.features),
    "mean of the descriptors": lambda seen: seen.features.descriptors.mean(axis=0),
    "colour histogram": color_histogram,
}


def images_in(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)


def read(path: Path, longest: int) -> npt.NDArray[np.uint8]:
    pixels = cv2.imread(str(path))
    factor = longest / max(pixels.shape)
    return pixels if factor >= 1 else cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)


def mean_count(views: list[Seen]) -> float:
    """Keypoints of an image."""
    return float(np.mean([len(seen.features) for seen in views]))


def sequence_recall(found: Float, sequences: npt.NDArray[np.str_]) -> float:
    """Of each image's others of its sequence, the share among as many nearest; the mean in percent."""
    shares = []
    for own, order in zip(sequences, nearest(found, len(found)), strict=True):
        count = int((sequences == own).sum()) - 1
        shares.append(np.mean(sequences[order[:count]] == own))
    return 100 * float(np.mean(shares))


def sequences_table(elf: ElfRuntime, root: Path, chosen: list[str], longest: int) -> None:
    files = [(folder.name, path) for folder in sorted(root.iterdir()) if folder.is_dir() for path in images_in(folder)]
    views = []
    for name, path in files:
        pixels = read(path, longest)
        views.append(Seen(name, pixels, elf.detect(pixels)))
    names = np.array([seen.sequence for seen in views])
    on = np.isin([name.split("_", 1)[-1] for name in names], chosen)
    print(f"{len(views)} images, {mean_count(views):.0f} keypoints each; recall in percent")
    print("| pooled | all | chosen on | the others |\n| --- | --- | --- | --- |")
    for title, pool in POOLED.items():
        rows = np.array([pool(seen) for seen in views], np.float64)
        parts = (np.ones(len(on), np.bool_), on, ~on)
        recalls = [sequence_recall(rows[part], names[part]) for part in parts if part.any()]
        print(f"| {title} | " + " | ".join(f"{recall:.1f}" for recall in recalls) + " |")


def shared_views(files: list[Path], longest: int) -> Float:
    """(I, I): of the points that one image sees, the share that the other one sees from nearly the same side."""
    cameras, found = [], []
    sift = cv2.SIFT_create(3000)
    for path in files:
        K, pose = read_camera(path.parents[1] / "gt_dense_cameras" / f"{path.name}.camera")
        pixels, full = read(path, longest), cv2.imread(str(path)).shape
        factor = pixels.shape[1] / full[1]
        resized = np.diag([factor, factor, 1.0]) @ K
        resized[:2, 2] += 0.5 * factor - 0.5  # pixel centres are at whole numbers
        cameras.append((resized, pose))
        found.append((*sift.detectAndCompute(pixels, None), pixels.shape[:2]))
    points: list[list[Float]] = [[] for _ in files]
    for i, j in combinations(range(len(files)), 2):
        for side in (i, j):
            points[side].append(triangulated(found[i], found[j], cameras[i], cameras[j]))
    shared = np.zeros((len(files), len(files)))
    for i in range(len(files)):
        scene = np.concatenate(points[i])
        for j in range(len(files)):
            K, pose = cameras[j]
            seen = scene @ pose[:3, :3].T + pose[:3, 3]
            x, y = (seen @ K.T)[:, :2].T / seen[:, 2]
            height, width = found[j][2]
            inside = (seen[:, 2] > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
            rays = [scene + T[:3, :3].T @ T[:3, 3] for T in (cameras[i][1], pose)]
            cosine = np.einsum("kd,kd->k", *rays) / np.linalg.norm(rays[0], axis=1) / np.linalg.norm(rays[1], axis=1)
            shared[i, j] = np.mean(inside & (cosine > _WITHIN))
    return shared


def triangulated(a: tuple, b: tuple, first: tuple[Float, Float], second: tuple[Float, Float]) -> Float:
    """(K, 3) points of the world in front of both cameras, from matches within a pixel of the true epipolar lines."""
    pairs = cv2.BFMatcher().knnMatch(a[1], b[1], k=2)
    good = [one for one, two in pairs if one.distance < 0.8 * two.distance]
    p = np.array([a[0][m.queryIdx].pt for m in good]).reshape(-1, 2)
    q = np.array([b[0][m.trainIdx].pt for m in good]).reshape(-1, 2)
    move = second[1] @ np.linalg.inv(first[1])
    x, y, z = move[:3, 3]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    F = np.linalg.inv(second[0]).T @ cross @ move[:3, :3] @ np.linalg.inv(first[0])
    lines = np.column_stack([p, np.ones(len(p))]) @ F.T
    away = np.abs((lines * np.column_stack([q, np.ones(len(q))])).sum(axis=1)) / np.linalg.norm(lines[:, :2], axis=1)
    p, q = p[away < 1], q[away < 1]
    found = cv2.triangulatePoints(first[0] @ first[1][:3], second[0] @ second[1][:3], p.T, q.T)
    world = (found[:3] / found[3]).T
    depths = [(world @ T[2, :3]) + T[2, 3] for T in (first[1], second[1])]
    return np.asarray(world[(depths[0] > 0) & (depths[1] > 0)])


def scene_table(elf: ElfRuntime, root: Path, longest: int) -> None:
    files = images_in(root / "images")
    shared = shared_views(files, longest)
    np.fill_diagonal(shared, -1)
    best = np.argsort(-shared, axis=1)
    pixels = [read(path, longest) for path in files]
    views = [Seen(root.name, image, elf.detect(image)) for image in pixels]
    print(f"{root.name}: {len(views)} images, {mean_count(views):.0f} keypoints each")
    print("| pooled | K = 2 | K = 3 | K = 4 |\n| --- | --- | --- | --- |")
    for title, pool in POOLED.items():
        order = nearest(np.array([pool(seen) for seen in views], np.float64), len(views))
        recalls = [np.mean([np.isin(o[:k], b[:k]).mean() for o, b in zip(order, best, strict=True)]) for k in (2, 3, 4)]
        print(f"| {title} | " + " | ".join(f"{100 * recall:.0f}" for recall in recalls) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequences", type=Path, help="folder of folders of images")
    parser.add_argument("--chosen-on", default="", help="sequences that a pooling was chosen on, by comma")
    parser.add_argument("--scene", type=Path, help="folder of images/ and gt_dense_cameras/")
    parser.add_argument("--longest", type=int, default=1000, help="longer images are reduced to it, in pixels")
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    elf = ElfRuntime(threads=args.threads)
    if args.sequences:
        sequences_table(elf, args.sequences, args.chosen_on.split(","), args.longest)
    if args.scene:
        scene_table(elf, args.scene, args.longest)


if __name__ == "__main__":
    main()
