"""A method in a process of its own, as it would be deployed, so that no other's memory or threads change its time.

OpenCV's SIFT, for example, takes half its time to get memory from the system and give it back, unless others in the
process have left some.
"""

from __future__ import annotations

from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from types import TracebackType

import cv2

from elf_eval.coordinates import Size
from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.methods import open_methods
from elf_eval.run.workers import end_with_parent


class MethodProcess:
    """A method that detects and describes one image, whenever it is asked to.

    Parameters
    ----------
    detector, descriptor : str
        As of `open_methods`.
    photo : ImageRef
        Decoded and resized to `size` once.
    limit : int
        At most so many keypoints.
    threads : int
        Of the method, and of OpenCV.

    Raises
    ------
    EvalError
        If the method can't be opened; in `run`, if it fails on the image.
    """

    def __init__(
        self, detector: str, descriptor: str | None, photo: ImageRef, size: Size | None, limit: int, threads: int
    ) -> None:
        context = get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, detector, descriptor, photo, size, limit, threads), daemon=True
        )
        self._process.start()
        theirs.close()
        self._answer()

    def run(self) -> int:
        """Extract once; the number of keypoints."""
        with suppress(OSError):  # a process that has ended does not answer either
            self._ours.send(True)
        return self._answer()

    def __enter__(self) -> MethodProcess:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        with suppress(OSError):
            self._ours.send(False)
        self._process.join(10)
        if self._process.is_alive():
            self._process.kill()

    def _answer(self) -> int:
        try:
            answer = self._ours.recv()
        except (EOFError, OSError) as error:
            raise EvalError("a method's process ended") from error
        if isinstance(answer, str):
            raise EvalError(answer)
        return int(answer)


def _serve(
    pipe: Connection,
    detector: str,
    descriptor: str | None,
    photo: ImageRef,
    size: Size | None,
    limit: int,
    threads: int,
) -> None:
    end_with_parent()
    cv2.setNumThreads(threads)
    try:
        method = open_methods(detector, descriptor, threads)
        image = photo.open(size)
        pipe.send(image.size[0])  # decodes now, because that is not the method's time
        while pipe.recv():
            pipe.send(len(method.extract(image, limit)))
    except (EOFError, KeyboardInterrupt):
        return
    except Exception as error:  # the process that asks reports it
        pipe.send(str(error) or type(error).__name__)
