"""The paper's own figures, to stand beside ours.

Benbihi, Geist, Pradalier, "ELF: Embedded Localisation of Features in pre-trained CNN", ICCV 2019:
(repeatability, matching score) in percent on HPatches and on the Webcam set.

The rows of ELF and SIFT are those of the paper's table.  The others come, to a tenth, from the authors' plotting
scripts (github.com/abenbihi/elf, plots/fig5_hpatch.py and fig5_webcam.py).  The scripts have the figures of SIFT and
SURF the other way round: SIFT's 51.2 / 24.6 stand in the authors' README too.  Of the table of gradients only one pair
of figures is known here.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

DATASETS = ("HPatches", "Webcam")

PAPER: Mapping[str, Mapping[str, tuple[float, float]]] = MappingProxyType(
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
        "Sobel": {},
        "Laplacian": {"HPatches": (65.5, 55.3)},
    }
)

# The rows of the paper's tables.
TABLES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "generic": tuple(name for name in PAPER if name not in ("Sobel", "Laplacian")),
        "gradients": ("ELF-VGG", "Sobel", "Laplacian"),
    }
)


def figures(row: str | None, dataset: str) -> str:
    """``rep / ms`` of a row of the paper; in words where there is no such row, or the row has no such figure."""
    if row is None:
        return "-"
    if row not in PAPER:
        return f"no row {row!r}"
    if dataset not in PAPER[row]:
        return "not given"
    rep, ms = PAPER[row][dataset]
    return f"{rep:.1f} / {ms:.1f}"
