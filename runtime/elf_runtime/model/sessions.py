"""The sessions of one model: one for each set of outputs that is asked for, and for each image size in use."""

from __future__ import annotations

import hashlib
import math
import threading
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import onnxruntime as ort

from elf_runtime.errors import ModelError, first_line

from .forking import forgets_when_forked
from .heap import trim_heap
from .onnx_file import has_external_data
from .ort_format import is_ort_format
from .providers import is_cpu
from .session import open_session
from .subgraph import with_outputs

Shape = tuple[int, ...]
_Key = tuple[frozenset[str], Shape | None, bool]  # outputs, size (None is any), whether of an image alone


class TensorInfo(NamedTuple):
    """An input or output of a model, as ONNX Runtime describes it: an int, a symbol or None per axis."""

    name: str
    type: str
    shape: list[int | str | None]


MUCH_LARGER = 2  # times the pixels: the memory that such an image took is not worth keeping for others


class Sessions:
    """Opens the sessions of a model as they are needed, and keeps those that are likely to be needed again.

    ONNX Runtime computes every output of a graph, asked for or not, and fuses more where it knows the image's size.  So
    each set of outputs has its own sessions: one for each of the image sizes used last, and a second one where images
    of that size come in batches.  A size that comes once is not worth a session.  It runs in one for any size, which
    counts as one of the sizes.  The first size of all is expected to come again, and so is every size on other
    providers than the CPU, which may take long to compile.  A model in ORT format can be neither cut nor given a size,
    so it has one session.  A model whose nodes have graphs of their own (If, Loop) can't be cut.
    An image that is looked at in several working sizes, its levels, counts as one size.

    Parameters
    ----------
    model : bytes
    name : str
        The model's name for messages.
    options : mapping
        Of `open_session`, ``providers`` as `resolve_providers` gives them.
    sizes : int
        For how many image sizes sessions are kept; 0: one session for all sizes.

    Raises
    ------
    ModelError, ProviderError
        As `open_session`: the model is opened once, here.

    Attributes
    ----------
    providers : list of str
        The active ones.
    metadata : mapping
    inputs, outputs : lists of TensorInfo
    """

    def __init__(self, model: bytes, name: str, options: Mapping[str, Any], sizes: int) -> None:
        self._model, self._name, self._options = model, name, options
        self._divisible = not is_ort_format(model)
        self._sizes = sizes if self._divisible else 0
        # A session to check the model only, where sizes get their own; another provider has to show that it starts.
        self._is_cpu = is_cpu(options["providers"])
        provisional = self._sizes > 0 and self._is_cpu
        if has_external_data(model):
            raise ModelError(f"{name}: its weights lie in other files (external data); an ELF model is one file")
        session, _ = open_session(model, **options, optimize=not provisional, name=name)
        self.providers: list[str] = list(session.get_providers())
        try:
            self.metadata: Mapping[str, str] = session.get_modelmeta().custom_metadata_map
            self.inputs, self.outputs = _tensors(session.get_inputs()), _tensors(session.get_outputs())
        except Exception as error:  # text that is not UTF-8, and what else ONNX Runtime can't tell of a model
            raise ModelError(f"{name}: what it says of itself can't be read: {first_line(error)}") from error
        self._all = frozenset(tensor.name for tensor in self.outputs)
        self._cuts: dict[frozenset[str], frozenset[str]] = {}  # outputs asked for -> those computed
        first = self.inputs[0].shape if self.inputs else []
        self._dims = [dim if isinstance(dim, str) else None for dim in first[:3]]
        self._at_once = self._sizes > 0 and not provisional
        # The least recently used first.
        self._open: dict[_Key, ort.InferenceSession] = {}
        if not provisional:
            self._open[self._all, None, False] = session
        self._levels = 1  # most working sizes of an image so far
        self._last: dict[frozenset[str], list[Shape]] = {}  # by outputs, the sizes that came last
        # Of a session of any size: the pixels of its last image, and those that the memory it keeps is enough for.
        self._pixels: dict[_Key, tuple[int, int]] = {}
        self._opening = threading.Lock()
        forgets_when_forked(self)

    def forget(self) -> None:
        """Start anew in a forked child: it can't use the parent's sessions, and a thread it lacks may hold the lock."""
        self._open, self._last, self._pixels = {}, {}, {}
        self._opening = threading.Lock()

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the model's bytes."""
        return hashlib.sha256(self._model).hexdigest()

    def __len__(self) -> int:
        return len(self._open)

    def get(
        self, outputs: Sequence[str], shape: Shape, expected: bool = False, levels: int = 1
    ) -> tuple[ort.InferenceSession, ort.RunOptions | None]:
        """A session that computes these outputs and no other, for images (N, h, w), and the options to run it with.

        It is for this size alone where the size came before among the last `sizes`, or is `expected` to come again.  Of
        images with several `levels`, that many times as many sizes are kept, and the first that many are expected.  An
        image alone has a session of its own too, which fuses more; in all others of that size the batch is free.  A
        session of any size gives its memory back after an image much larger than the last, or much smaller than one
        before.
        """
        alone, size = shape[0] == 1, shape[1:]
        with self._opening:
            self._levels = max(self._levels, levels)
            wanted = self._computed_for(outputs)
            key: _Key = (wanted, None, False)
            if self._sizes:
                own: _Key = (wanted, size, alone)
                again = self._comes_again(wanted, size, levels)
                key = own if again or expected or self._at_once or own in self._open else key
            session = self._open.pop(key, None)
            if session is None:
                fixed = zip(self._dims, shape, (alone, True, True), strict=True) if key[1] else ()
                dims = {name: side for name, side, known in fixed if name and known}
                part = self._model if wanted == self._all else with_outputs(self._model, outputs, self._name)
                session = open_session(part, **self._options, dims=dims, name=self._name)[0]
                self._make_room(wanted, key[1])
            self._open[key] = session
            return session, None if key[1] else self._shrinking(key, math.prod(shape))

    def _computed_for(self, outputs: Sequence[str]) -> frozenset[str]:
        """What a session for these outputs computes: all, where the model can't be cut down to them."""
        wanted = frozenset(outputs)
        if not self._divisible or wanted == self._all:
            return self._all
        if wanted not in self._cuts:
            try:
                with_outputs(self._model, outputs, self._name)
                self._cuts[wanted] = wanted
            except ModelError:  # nodes with graphs of their own (If, Loop)
                self._cuts[wanted] = self._all
        return self._cuts[wanted]

    def _shrinking(self, key: _Key, pixels: int) -> ort.RunOptions | None:
        last, kept = self._pixels.get(key, (pixels, 0))
        shrinks = self._is_cpu and (kept > MUCH_LARGER * pixels or pixels > MUCH_LARGER * last)
        self._pixels[key] = pixels, 0 if shrinks else max(pixels, kept)
        if not shrinks:
            return None
        options = ort.RunOptions()
        options.add_run_config_entry("memory.enable_memory_arena_shrinkage", "cpu:0")
        return options

    def _comes_again(self, wanted: frozenset[str], size: Shape, levels: int) -> bool:
        """Whether a size is one of the first image for these outputs, or among the last ones, which it joins."""
        last = self._last.get(wanted, [])
        self._last[wanted] = [*(other for other in last if other != size), size][-self._sizes * self._levels :]
        return len(last) < levels or size in last

    def _make_room(self, wanted: frozenset[str], size: Shape | None) -> None:
        """Drop, of the sessions for the same outputs, those of sizes used longest ago; and the start's of any size."""
        if self._at_once:
            self._open.pop((self._all, None, False), None)
        mine = [key for key in self._open if key[0] == wanted]
        others = list(dict.fromkeys(key[1] for key in reversed(mine) if key[1] != size))
        dropped = [key for key in mine if key[1] in others[max(0, self._sizes * self._levels - 1) :]]
        for key in dropped:
            del self._open[key]
            self._pixels.pop(key, None)
        if dropped:
            trim_heap()


def _tensors(records: Sequence[ort.NodeArg]) -> list[TensorInfo]:
    """Plain copies: ONNX Runtime's own records would keep the session alive.  Without a shape the rank counts as 0."""
    return [TensorInfo(record.name, record.type, list(record.shape or ())) for record in records]
