"""Writes the model that the runtime package carries: ELF-VGG at pool1, described by conv3_3, at half resolution.

    make models

The weights are found as by ``elf-export --net vgg``; the trunk up to pool3 is in the present bundled model
itself, so this needs no network once there is one.  models/README.md states the file's SHA-256.
"""

from __future__ import annotations

import hashlib
import sys

from elf_export import export_network
from elf_runtime import DetectionParams
from elf_runtime.session import bundled_model

# Half resolution, descriptors from before the last ReLU, and the level chosen below an outlier's reach: more
# keypoints, in a steadier number, that match better than with the paper's settings, at a seventh of the arithmetic
# (models/README.md has the figures).
DETECTION = DetectionParams(
    denoise=(5, 1.2), threshold_blur=(5, 4.0), threshold="kapur", normalize=0.95, nms_radius=8, border=10,
    scale=0.5, subpixel=True,
)  # fmt: skip


def main() -> int:
    result = export_network(
        "vgg", "pool1", ["conv3_3"], bundled_model(), weights=sys.argv[1] if sys.argv[1:] else None,
        force=True, detection=DETECTION, log=print,
    )  # fmt: skip
    data = result.path.read_bytes()
    print(f"{result.path}: {len(data)} bytes, SHA-256 {hashlib.sha256(data).hexdigest()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
