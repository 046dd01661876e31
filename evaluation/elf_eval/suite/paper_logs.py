"""The paper's rotation, scale and 3D viewpoint figures, as their authors' logs have them.

github.com/abenbihi/elf at commit 286adaf, plots/res/METHOD/NUMBER/log.txt; which log is which, and the angles, which
the logs don't name, are in plots/fig6.py (scale), fig7.py (rotation) and fig8.py (viewpoint).  ELF is VGG with
denoising (5, 2) and threshold (17, 6).  Scale and rotation are means over HPatches' 116 scenes, image 1 of each against
views of itself; the viewpoint's are single pairs, the first image of each of Strecha's scenes against each other one.
What the logs say of the numbers of keypoints is not here.

The logs of scale and rotation have the same figures for i_objects and i_table, of every method.  LIFT's of rotation has
for v_feast and v_wall the same figures at 170 degrees as at 130.  The means are over the logs as they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

Score = tuple[float, float]  # repeatability and matching score, in percent
Curve = Mapping[float, Score]  # by factor, angle in degrees, or number of the second image
Curves = Mapping[str, Curve]  # by row of the paper

EXPERIMENTS = ("generic", "scale", "rotation", "viewpoint", "image matching")

LOGGED = ("ELF-VGG", "SIFT", "SuperPoint", "LF-Net", "LIFT")


def _curves(values: Sequence[float], rows: Mapping[str, tuple[Sequence[float], Sequence[float]]]) -> Curves:
    """Of each row its repeatabilities and its matching scores at these values."""
    return {row: dict(zip(values, zip(*scores, strict=True), strict=True)) for row, scores in rows.items()}


def _images(count: int) -> list[float]:
    return [float(n) for n in range(1, count + 1)]


# fmt: off
CURVES: Mapping[str, Curves] = MappingProxyType({
    "scale": _curves((1.25, 1.5, 1.75, 2.0), {
        "ELF-VGG": (
            (74.859, 70.772, 67.197, 64.757),
            (69.327, 53.229, 36.789, 25.629),
        ),
        "SIFT": (
            (72.532, 71.043, 70.097, 70.374),
            (51.409, 49.663, 49.835, 50.747),
        ),
        "SuperPoint": (
            (85.211, 86.262, 85.170, 83.356),
            (84.778, 85.367, 83.309, 78.566),
        ),
        "LF-Net": (
            (66.218, 58.108, 53.399, 50.021),
            (55.176, 35.344, 18.362, 8.727),
        ),
        "LIFT": (
            (66.935, 62.366, 58.136, 54.532),
            (62.398, 57.252, 51.848, 47.147),
        ),
    }),
    "rotation": _curves((10.0, 50.0, 90.0, 130.0, 170.0, 210.0), {
        "ELF-VGG": (
            (69.644, 65.666, 65.707, 61.517, 62.387, 60.008),
            (66.077, 24.813, 6.328, 3.236, 5.309, 3.547),
        ),
        "SIFT": (
            (70.838, 66.506, 67.906, 66.281, 70.203, 68.274),
            (50.970, 41.922, 42.177, 40.048, 46.903, 43.263),
        ),
        "SuperPoint": (
            (80.296, 73.780, 75.309, 70.299, 74.526, 72.058),
            (79.967, 21.663, 0.556, 0.523, 1.143, 0.634),
        ),
        "LF-Net": (
            (75.570, 55.829, 54.434, 48.935, 49.829, 48.641),
            (69.218, 37.597, 33.697, 27.108, 29.931, 27.840),
        ),
        "LIFT": (
            (71.924, 54.790, 53.967, 52.039, 59.747, 54.430),
            (64.179, 28.872, 19.797, 12.123, 15.426, 13.541),
        ),
    }),
})

# By scene: repeatability, then matching score, of the images from 0001 on, each against 0000.
VIEWPOINT: Mapping[str, Curves] = MappingProxyType({
    "fountain-P11": _curves(_images(10), {
        "ELF-VGG": (
            (71.3, 60.3, 47.7, 44.7, 37.6, 32.6, 26.6, 18.1, 24.6, 18.2),
            (66.0, 45.6, 27.3, 15.8, 10.4, 6.4, 3.7, 1.0, 2.3, 2.3),
        ),
        "SIFT": (
            (59.1, 46.0, 39.4, 32.2, 26.1, 25.7, 24.6, 12.3, 15.8, 11.2),
            (30.9, 20.6, 13.1, 9.7, 8.0, 7.1, 3.4, 2.0, 1.9, 0.5),
        ),
        "SuperPoint": (
            (68.1, 61.3, 56.7, 47.4, 42.0, 36.3, 34.8, 27.0, 24.7, 17.8),
            (67.3, 56.2, 44.5, 32.1, 25.6, 20.1, 16.0, 7.8, 3.5, 1.0),
        ),
        "LF-Net": (
            (58.4, 47.8, 43.1, 36.0, 27.4, 23.7, 21.6, 18.6, 20.2, 20.2),
            (47.9, 28.4, 20.9, 13.8, 8.4, 4.9, 2.7, 1.1, 0.9, 0.3),
        ),
        "LIFT": (
            (59.6, 49.8, 43.1, 38.5, 36.3, 29.3, 27.3, 21.2, 21.8, 15.6),
            (44.8, 31.1, 23.6, 19.0, 15.0, 9.6, 7.4, 3.1, 1.5, 0.7),
        ),
    }),
    "entry-P10": _curves(_images(9), {
        "ELF-VGG": (
            (73.0, 69.1, 57.3, 53.6, 58.8, 44.7, 41.5, 44.3, 38.6),
            (70.0, 53.4, 32.0, 21.7, 31.2, 19.7, 13.0, 11.4, 10.0),
        ),
        "SIFT": (
            (57.4, 65.0, 52.7, 36.9, 49.6, 42.4, 41.4, 36.0, 28.0),
            (24.4, 22.0, 15.4, 8.2, 7.8, 5.1, 4.7, 2.4, 2.6),
        ),
        "SuperPoint": (
            (66.5, 68.7, 66.6, 53.5, 57.0, 51.8, 36.7, 36.0, 31.4),
            (64.1, 59.7, 37.7, 25.4, 37.0, 22.8, 11.0, 8.0, 5.6),
        ),
        "LF-Net": (
            (72.7, 66.3, 46.4, 41.4, 49.4, 42.9, 36.6, 31.7, 27.9),
            (62.0, 36.6, 10.7, 9.1, 11.2, 13.3, 6.1, 4.3, 0.3),
        ),
        "LIFT": (
            (72.1, 60.4, 50.8, 40.3, 53.7, 42.5, 33.1, 28.0, 22.6),
            (56.5, 32.3, 18.9, 10.5, 14.6, 11.2, 4.4, 2.6, 1.2),
        ),
    }),
    "Herz-Jesu-P8": _curves(_images(7), {
        "ELF-VGG": (
            (57.3, 46.1, 42.8, 37.7, 36.2, 33.0, 32.5),
            (47.7, 31.1, 29.0, 17.3, 12.9, 10.8, 7.6),
        ),
        "SIFT": (
            (58.3, 40.3, 33.2, 30.7, 27.4, 22.9, 23.7),
            (38.0, 19.2, 11.9, 10.6, 4.5, 3.7, 1.8),
        ),
        "SuperPoint": (
            (70.0, 47.2, 41.0, 32.0, 27.2, 21.7, 19.5),
            (68.1, 42.6, 32.4, 18.5, 14.7, 12.2, 9.4),
        ),
        "LF-Net": (
            (55.0, 47.1, 43.8, 35.8, 36.2, 32.0, 32.7),
            (43.0, 31.4, 24.5, 12.8, 9.7, 8.8, 4.9),
        ),
        "LIFT": (
            (51.4, 43.6, 38.2, 36.0, 33.4, 22.5, 16.5),
            (43.1, 28.4, 17.5, 10.4, 9.0, 4.3, 2.8),
        ),
    }),
})
# fmt: on

_SCENES = {
    "fountain-P11": ("fountain", "fountaindense"),
    "entry-P10": ("entry", "castleentry", "castleentrydense"),
    "Herz-Jesu-P8": ("herzjesu", "herzjesudense", "herzjesus", "herzjesusp8"),
}


def experiment(dataset: Mapping[str, Any]) -> str:
    """Which of the paper's experiments a dataset of the results is: one of `EXPERIMENTS`.

    What its suite says, or else by what its pairs vary in.
    """
    by_parameter = {"scale": "scale", "rotation (degrees)": "rotation"}
    return str(dataset.get("paper") or by_parameter.get(dataset.get("parameter") or "", "generic"))


def scene_of(name: str) -> str | None:
    """The scene of `VIEWPOINT` that a folder's name stands for, such as ``castle_entry_dense``; None for others."""
    short = "".join(c for c in name.lower() if c.isalnum())
    whole = {scene: "".join(c for c in scene.lower() if c.isalnum()) for scene in VIEWPOINT}
    return next((scene for scene in VIEWPOINT if short in (whole[scene], *_SCENES[scene])), None)


def mean(scores: Iterable[Score]) -> Score:
    """Of each of the two."""
    reps, matching = zip(*scores, strict=True)
    return sum(reps) / len(reps), sum(matching) / len(matching)
