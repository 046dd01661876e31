"""How methods and datasets are written on a command line: ``kind:argument?option=value&option=value``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from elf_runtime.errors import suggestion
from elf_runtime.params import SETTINGS, setting_value

from .errors import EvalError

T = TypeVar("T")


@dataclass
class Spec:
    """A parsed text such as ``elf:vgg.onnx?preset=paper``.

    Attributes
    ----------
    text : str
        As written.
    kind, argument : str
        Before and after the first colon; the argument may be empty.
    options : dict of str
        Those that nobody has taken yet.  `finish` refuses what is left, so no setting is dropped in silence.
    known : list of str
        Names of the options that were asked for.
    shared : bool
        Whether a model is to be opened once for all its settings, which share what its network gives for an image.
    incomplete : dict, optional
        Where given, a dataset leaves out scenes of which something is missing, and writes here which and why.
    """

    text: str
    kind: str
    argument: str
    options: dict[str, str]
    known: list[str] = field(default_factory=list)
    shared: bool = False
    incomplete: dict[str, str] | None = None

    @classmethod
    def parse(cls, text: str) -> Spec:
        """Split a text.  Raises EvalError where an option is not ``name=value``, or given twice."""
        head, _, tail = text.partition("?")
        kind, _, argument = head.partition(":")
        options: dict[str, str] = {}
        for item in filter(None, tail.split("&")):
            name, equals, value = item.partition("=")
            if not equals:
                raise EvalError(f"{text}: option {item!r} is not name=value")
            if name in options:
                raise EvalError(f"{text}: option {name} is given twice")
            options[name] = value
        return cls(text, kind, argument, options)

    def take(self, name: str, convert: Callable[[str], T], default: T) -> T:
        """The option's value, converted.

        Raises
        ------
        EvalError
            Naming the text, the option and the value, where it can't be converted.
        """
        self.known.append(name)
        if name not in self.options:
            return default
        value = self.options.pop(name)
        try:
            return convert(value)
        except (ValueError, TypeError) as error:
            what = str(error) if str(error).startswith(f"{name} is ") else f"option {name}={value}: {error}"
            raise EvalError(f"{self.text}: {what}") from error

    def settings(self, names: Sequence[str] = SETTINGS) -> dict[str, Any]:
        """The fields of `elf_runtime.DetectionParams`, of those named, that the options give: ``scale=0.5``, ..."""
        changes = {name: self.take(name, partial(setting_value, name), None) for name in names}
        return {name: value for name, value in changes.items() if value is not None}

    def finish(self) -> None:
        """Raises EvalError where nobody has taken an option."""
        if self.options:
            near = suggestion(sorted(self.options)[0], self.known)
            raise EvalError(
                f"{self.text}: unknown options {sorted(self.options)}; known are {sorted(self.known)}{near}"
            )

    @contextmanager
    def whole(self, scene: str) -> Iterator[None]:
        """Around the reading of a scene: an EvalError leaves it out where `incomplete` is given, and else goes on."""
        try:
            yield
        except EvalError as error:
            if self.incomplete is None:
                raise
            self.incomplete[scene] = str(error)

    def file(self, what: str) -> Path:
        """The argument as the path of an existing file."""
        path = Path(self.argument).expanduser()
        if not self.argument or not path.is_file():
            raise EvalError(f"{self.text}: {what}: no such file: {self.argument or '(none given)'}")
        return path

    def folder(self) -> Path:
        """The argument as the path of an existing folder."""
        path = Path(self.argument).expanduser()
        if not self.argument or not path.is_dir():
            raise EvalError(f"{self.text}: no such folder: {self.argument or '(none given)'}")
        return path


def comma_separated(text: str) -> list[str]:
    """``a,b`` -> ["a", "b"]; none in an empty text."""
    return [name for name in text.split(",") if name]


def boolean(text: str) -> bool:
    """``true`` or ``false``; a ValueError on anything else."""
    if text not in ("true", "false"):
        raise ValueError("expected true or false")
    return text == "true"
