"""The paper's own figures, to stand beside ours as the paper's.

Benbihi, Geist, Pradalier, "ELF: Embedded Localisation of Features in pre-trained CNN", ICCV 2019:
(repeatability, matching score) in percent on HPatches and on the Webcam set.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

PAPER: Mapping[str, Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "ELF-VGG": {"HPatches": (63.81, 51.84), "Webcam": (53.23, 43.73)},
        "ELF-AlexNet": {"HPatches": (51.30, 35.21), "Webcam": (38.54, 31.92)},
        "ELF-Xception": {"HPatches": (48.06, 29.81), "Webcam": (49.84, 35.48)},
        "ELF-SuperPoint": {"HPatches": (59.7, 44.32), "Webcam": (46.29, 18.11)},
        "ELF-LFNet": {"HPatches": (60.1, 44.56), "Webcam": (41.90, 33.43)},
        "SIFT": {"HPatches": (51.19, 24.58), "Webcam": (28.25, 8.30)},
    }
)
