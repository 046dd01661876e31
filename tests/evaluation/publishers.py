"""Made-up miniatures of the paper's data sets, in the layouts of their publishers, and files of features of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from scenes import SIZE, photograph, write_hpatches

from elf_eval.data import open_dataset
from elf_eval.methods import open_method
from helpers import TINY

WEBCAM_SCENES = ("Chamonix", "StLouis")


def write_publishers(root: Path) -> dict[str, str]:
    """All of them below `root`; returns the variables of the suites that name them."""
    folders = {name: root / name for name in ("hpatches", "webcam", "strecha", "features", "models")}
    for folder in folders.values():
        folder.mkdir()
    write_hpatches(folders["hpatches"], ["i_light", "v_turn"])
    _as_ppm(folders["hpatches"])
    for number, scene in enumerate(WEBCAM_SCENES):
        inner = folders["webcam"] / scene / "test" / "image_color"
        inner.mkdir(parents=True)
        for n in range(3):
            shade = photograph(10 + number).astype(float) * (1.0 - 0.2 * n)
            cv2.imwrite(str(inner / f"{scene}_{n:02d}.png"), shade.astype(np.uint8))
    _write_scene(folders["strecha"] / "fountain-P11", depth=True)
    _write_scene(folders["strecha"] / "entry-P10", depth=False)
    _write_models(folders["models"])
    return {f"ELF_{name.upper()}": str(folder) for name, folder in folders.items()}


def write_features(variables: dict[str, str], dataset: str, names: list[str]) -> None:
    """SIFT's features as another program's, of every image of a dataset, for each of `names`.

    NAME-at-elf are at the keypoints of the suites' ELF-VGG.
    """
    sift = open_method("sift", 1)
    elf = open_method(f"elf:{variables['ELF_MODELS']}/elf-vgg.onnx?preset=paper-components&descriptor=pool3", 1)
    for ref in open_dataset(dataset).images():
        image = ref.open((320, 240))
        for name in names:
            found = (elf if name.endswith("-at-elf") else sift).extract(image, 60)
            path = Path(variables["ELF_FEATURES"], name, f"{ref.name}.npz")
            path.parent.mkdir(parents=True, exist_ok=True)
            np.savez(path, keypoints=found.keypoints, scores=found.scores, descriptors=found.descriptors)


def _write_models(folder: Path) -> None:
    """A tiny network under the names of the paper's, its layers called pool3 and pool4."""
    tiny = TINY.read_bytes()
    for name in ("vgg", "alexnet", "xception", "superpoint", "lfnet", "lfnet-webcam"):
        renamed = tiny.replace(b"relu2", b"pool3").replace(b"pool1", b"pool4")
        (folder / f"elf-{name}.onnx").write_bytes(renamed if name == "vgg" else tiny)


def _as_ppm(root: Path) -> None:
    for path in root.glob("*/*.png"):
        cv2.imwrite(str(path.with_suffix(".ppm")), cv2.imread(str(path)))
        path.unlink()


def _write_scene(folder: Path, depth: bool) -> None:
    """A wall 5 units in front of three cameras, each a third of a unit to the right of the last."""
    images, cameras = folder / "images", folder / "gt_dense_cameras"
    images.mkdir(parents=True)
    cameras.mkdir()
    wall = photograph(20)
    for n in range(3):
        shift = np.float32([[1, 0, -100 * n / 3 / 5], [0, 1, 0]])
        cv2.imwrite(str(images / f"000{n}.jpg"), cv2.warpAffine(wall, shift, SIZE))
        text = f"100 0 99.5\n0 100 79.5\n0 0 1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n{n / 3} 0 0\n{SIZE[0]} {SIZE[1]}\n"
        (cameras / f"000{n}.jpg.camera").write_text(text)
        if depth:
            np.save(images / f"000{n}.depth.npy", np.full((SIZE[1], SIZE[0]), 5.0, np.float32))
