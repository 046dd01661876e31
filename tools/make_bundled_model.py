"""Writes the models that the runtime package carries: ELF-VGG at relu2_1, described by 128 values of conv3_2.

    make models

One network in fp32, whole, and in int8, compressed to low ranks.  The weights are found as by ``elf-export --net vgg``;
those up to conv3_2 are in the present fp32 model itself, so this needs no network once there is one.  models/README.md
states the files' SHA-256.
"""

from __future__ import annotations

import hashlib
import sys

from elf_export import Compression, Reduction, export_network
from elf_runtime import preset
from elf_runtime.model.bundled import BUNDLED, bundled_model

DETECTOR = {"conv1_2": 20, "conv2_1": 32}
DESCRIBER = {"vgg:conv1_2": 16, "vgg:conv2_1": 32, "vgg:conv2_2": 32, "vgg:conv3_1": 64}


def main() -> int:
    for precision in BUNDLED:
        whole = precision == "fp32"
        result = export_network(
            "vgg", "relu2_1", ["conv3_2"], bundled_model(precision), weights=sys.argv[1] if sys.argv[1:] else None,
            force=True, detection=preset("default"), log=print, precision=precision, pool="average", desc_scale=0.75,
            reduction=Reduction(128, separate=whole),
            compression=None if whole else Compression(ranks=DETECTOR | DESCRIBER),
        )  # fmt: skip
        data = result.path.read_bytes()
        print(f"{result.path}: {len(data)} bytes, SHA-256 {hashlib.sha256(data).hexdigest()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
