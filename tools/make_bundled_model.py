"""Writes the models that the runtime package carries: ELF-VGG at relu2_1, described by 128 values of conv3_2.

    make models

One network in fp32 and in int8.  The weights are found as by ``elf-export --net vgg``; those up to conv3_2 are in the
present fp32 model itself, so this needs no network once there is one.  models/README.md states the files' SHA-256.
"""

from __future__ import annotations

import hashlib
import sys

from elf_export import Reduction, export_network
from elf_runtime import preset
from elf_runtime.model.bundled import BUNDLED, bundled_model


def main() -> int:
    for precision in BUNDLED:
        result = export_network(
            "vgg", "relu2_1", ["conv3_2"], bundled_model(precision), weights=sys.argv[1] if sys.argv[1:] else None,
            force=True, detection=preset("default"), log=print, precision=precision,
            reduction=Reduction(128, separate=precision == "fp32"),
        )  # fmt: skip
        data = result.path.read_bytes()
        print(f"{result.path}: {len(data)} bytes, SHA-256 {hashlib.sha256(data).hexdigest()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
