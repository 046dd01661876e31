"""The paper's own figures, to stand beside ours.

Benbihi, Geist, Pradalier, "ELF: Embedded Localisation of Features in pre-trained CNN", ICCV 2019:
(repeatability, matching score) in percent on HPatches and on the Webcam set.

The rows of ELF and SIFT are those of the paper's table.  The others come, to a tenth, from the authors' plotting
scripts (github.com/abenbihi/elf, plots/fig5_hpatch.py and fig5_webcam.py).  The scripts have the figures of SIFT and
SURF the other way round: SIFT's 51.2 / 24.6 stand in the authors' README too.  Of the table of gradients only one pair
of figures is known here.  Rotation, scale and 3D viewpoint are in `paper_logs`.

Of detector and descriptor apart only matching scores are known (plots/fig9.py): each method with ELF's keypoints, and
with ELF's descriptor, VGG's pool3.  There LF-Net's own score on HPatches is 34.2, where the other script has 35.6.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from .paper_logs import LOGGED

DATASETS = ("HPatches", "Webcam")

Figures = tuple[float | None, float]  # repeatability where it is known, and matching score


_HYBRIDS = ("AlexNet", "Xception")  # whose descriptors the paper's table of gradients has too; VGG's is the plain row


def _apart(hpatches: float, webcam: float) -> Mapping[str, Figures]:
    return {"HPatches": (None, hpatches), "Webcam": (None, webcam)}


PAPER: Mapping[str, Mapping[str, Figures]] = MappingProxyType(
    {
        "ELF-VGG": {"HPatches": (63.81, 51.84), "Webcam": (53.23, 43.73)},
        "ELF-AlexNet": {"HPatches": (51.30, 35.21), "Webcam": (38.54, 31.92)},
        "ELF-Xception": {"HPatches": (48.06, 29.81), "Webcam": (49.84, 35.48)},
        "ELF-SuperPoint": {"HPatches": (59.7, 44.32), "Webcam": (46.29, 18.11)},
        "ELF-LFNet": {"HPatches": (60.1, 44.56), "Webcam": (41.90, 33.43)},
        "LF-Net": {"HPatches": (61.2, 35.6), "Webcam": (48.3, 18.1)},
        "SuperPoint": {"HPatches": (68.6, 57.1), "Webcam": (46.4, 32.4)},
        "LIFT": {"HPatches": (54.7, 34.0), "Webcam": (42.2, 17.8)},
        "SIFT": {"HPatches": (51.19, 24.58), "Webcam": (28.25, 8.30)},
        "SURF": {"HPatches": (54.5, 26.1), "Webcam": (33.9, 10.1)},
        "ORB": {"HPatches": (53.4, 14.8), "Webcam": (31.6, 1.3)},
        "KAZE": {"HPatches": (56.9, 29.8), "Webcam": (41.0, 13.9)},
        "TILDE": {"HPatches": (66.0, 46.7), "Webcam": (52.5, 34.7)},
        "MSER": {"HPatches": (47.82, 21.08), "Webcam": (52.2, 6.1)},
        "ELF-VGG, pool3": {"HPatches": (None, 51.3)},
        "LF-Net at ELF's keypoints": _apart(39.2, 26.7),
        "SuperPoint at ELF's keypoints": _apart(54.4, 39.6),
        "LIFT at ELF's keypoints": _apart(42.5, 30.8),
        "SIFT at ELF's keypoints": _apart(50.6, 36.8),
        "SURF at ELF's keypoints": _apart(30.9, 19.1),
        "ORB at ELF's keypoints": _apart(37.0, 6.6),
        "LF-Net + ELF's descriptor": _apart(44.2, 30.7),
        "SuperPoint + ELF's descriptor": _apart(53.7, 34.6),
        "LIFT + ELF's descriptor": _apart(39.5, 26.8),
        "SIFT + ELF's descriptor": _apart(27.0, 13.2),
        "SURF + ELF's descriptor": _apart(35.0, 21.4),
        "ORB + ELF's descriptor": _apart(20.0, 13.9),
        "Sobel": {},
        "Laplacian": {"HPatches": (65.5, 55.3)},
        **{f"{operator} + {network}": {} for network in _HYBRIDS for operator in ("Sobel", "Laplacian")},
    }
)

_COMPARED = ("LF-Net", "SuperPoint", "LIFT", "SIFT", "SURF", "ORB")

# The rows of the paper's tables.
TABLES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "generic": (
            *(f"ELF-{network}" for network in ("VGG", "AlexNet", "Xception", "SuperPoint", "LFNet")),
            *("LF-Net", "SuperPoint", "LIFT", "SIFT", "SURF", "ORB", "KAZE", "TILDE", "MSER"),
        ),
        "gradients": (
            *("ELF-VGG", "Sobel", "Laplacian"),
            *(f"{detector}{network}" for network in _HYBRIDS for detector in ("ELF-", "Sobel + ", "Laplacian + ")),
        ),
        "robustness": LOGGED,
        "ELF's descriptor": (
            "ELF-VGG, pool3",
            *(row for name in _COMPARED for row in (name, f"{name} + ELF's descriptor")),
            "TILDE",  # which has no descriptor of its own
        ),
        "ELF's keypoints": (
            "ELF-VGG, pool3",
            *(row for name in _COMPARED for row in (f"{name} at ELF's keypoints", name)),
        ),
    }
)


def figures(row: str | None, dataset: str) -> str:
    """``rep / ms`` of a row of the paper, ``- / ms`` where only that is known.

    In words where there is no such row, or the row has no such figure.
    """
    if row is None:
        return "-"
    if row not in PAPER:
        return f"no row {row!r}"
    if dataset not in PAPER[row]:
        return "not given"
    rep, ms = PAPER[row][dataset]
    return f"- / {ms:.1f}" if rep is None else f"{rep:.1f} / {ms:.1f}"
