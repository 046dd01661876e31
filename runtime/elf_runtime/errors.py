"""Every error that the runtime raises on purpose."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

LONGEST = 10_000  # characters of an error's text
LONGEST_LINE = 2000


class ElfError(Exception):
    """Base of the errors below: catch this one to catch them all.

    Its text is safe to print, although names and metadata come from files: it is cut to a length, and what a terminal
    would obey is escaped.

    Attributes
    ----------
    has_rows : bool
        Whether the text is a list, a first line with rows below it.  Commands print any other text as one line.
    """

    has_rows = False

    def __str__(self) -> str:
        return "\n".join(map(printable, shortened(super().__str__(), LONGEST).split("\n")))


class ModelError(ElfError):
    """A model file that is missing, unreadable, not ONNX, or not an ELF model."""


class ContractError(ModelError):
    """An ONNX model whose ``elf.*`` metadata is absent, of another schema, or at odds with its tensors."""


class ProviderError(ElfError):
    """An execution provider that is unknown, not installed, or failed to start."""


class ImageError(ElfError, ValueError):
    """An image, mask or list of points that can't be processed: wrong type, shape or values."""


class SettingError(ElfError, ValueError):
    """A detection setting outside its range, or an unknown preset."""


def printable(text: str) -> str:
    """`text` with control characters, and what is not Unicode, escaped: ``\\x1b``."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shortened(text: str, most: int) -> str:
    """`text` in at most `most` characters.  The middle is left out, because beginning and end say most."""
    half = (most - 5) // 2
    return text if len(text) <= most else f"{text[:half]} ... {text[-half:]}"


def suggestion(word: object, known: Iterable[str]) -> str:
    """``"; did you mean 'pool2'?"`` where one of the known words is near, for the end of an error; else empty."""
    near = get_close_matches(str(word), list(known), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def one_line(text: str) -> str:
    """`text` in one line, safe to print."""
    return printable(shortened(" ".join(text.split()), LONGEST_LINE))


def reason(error: BaseException) -> str:
    """The error's text; an OSError's without its number and file."""
    return (isinstance(error, OSError) and error.strerror) or str(error)


def first_line(error: BaseException) -> str:
    """The first line of what an error says, at most 300 characters; its type where it says nothing."""
    return (str(error).strip() or type(error).__name__).splitlines()[0][:300]
