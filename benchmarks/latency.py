"""The latency benchmark: ``elf-bench`` under another name, for a checkout.  See ``--help``."""

from __future__ import annotations

import sys

from elf_runtime.commands.bench import main

if __name__ == "__main__":
    sys.exit(main())
