"""Every error that the runtime raises on purpose."""

from __future__ import annotations


class ElfError(Exception):
    """Base of the errors below: catch this one to catch them all."""


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


def reason(error: BaseException) -> str:
    """The error's text; an OSError's without its number and file."""
    return (isinstance(error, OSError) and error.strerror) or str(error)


def first_line(error: BaseException) -> str:
    """The first line of what an error says, at most 300 characters; its type where it says nothing."""
    return (str(error).strip() or type(error).__name__).splitlines()[0][:300]
