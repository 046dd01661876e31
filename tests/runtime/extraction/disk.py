"""A file system of fsspec that is none of its own, ``disk:///folder/1.jpg``, whose users can be made to die."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

from fsspec.implementations.local import LocalFileSystem


class Disk(LocalFileSystem):  # type: ignore[misc]
    """Files of this machine.

    ``1.jpg.kills`` beside an image says how many processes are to die of reading it, and ``out.kills`` beside a folder
    how many of removing a file there.
    """

    protocol = "disk"

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return str(super()._strip_protocol(str(path).removeprefix("disk://")))

    def unstrip_protocol(self, name: str) -> str:
        return f"disk://{self._strip_protocol(name)}"

    def cat_file(self, path: str, *args: Any, **options: Any) -> Any:
        self._die_if_told(self._strip_protocol(path))
        return super().cat_file(path, *args, **options)

    def rm_file(self, path: str) -> None:
        self._die_if_told(str(Path(self._strip_protocol(path)).parent))
        super().rm_file(path)

    def _die_if_told(self, path: str) -> None:
        kills = Path(f"{path}.kills")
        if kills.exists() and (left := int(kills.read_text())):
            kills.write_text(str(left - 1))
            os.kill(os.getpid(), signal.SIGKILL)
