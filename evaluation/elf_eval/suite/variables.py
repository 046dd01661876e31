"""``${NAME}`` in a suite's texts: an environment variable, or else one of the suite's own."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping

from elf_eval.errors import EvalError

_VARIABLE = re.compile(r"\$\{(\w+)\}")


def expand(text: str, own: Mapping[str, str]) -> str:
    """`text` with its ``${NAME}`` replaced.

    Raises
    ------
    EvalError
        On a name that is neither in the environment nor in `own`.
    """

    def value(match: re.Match[str]) -> str:
        name = match[1]
        if name not in os.environ and name not in own:
            raise EvalError(f"{text}: {name} is not set; set it in the environment or under [variables]")
        return os.environ[name] if name in os.environ else own[name]

    return _VARIABLE.sub(value, text)


def unexpand(text: str, own: Mapping[str, str]) -> str:
    """`text` with ``${NAME}`` for the values of `own`'s names, where a value is a path or the beginning of one.

    A value that is a single word, such as "features", may stand in a sentence too: it is a path only before a slash, or
    directly behind a kind's colon (``npz:features``).
    """
    values = {name: expand("${" + name + "}", own).rstrip("/") for name in own}
    for name in sorted(filter(values.get, values), key=lambda name: -len(values[name])):
        # "." is one in "./a.onnx" before the slash alone, "models" is none in "my-models" and "a/models"
        whole = rf"(?<![\w./-]){re.escape(values[name])}(?![\w.-])"
        if re.fullmatch(r"[\w.-]+", values[name]):
            whole = rf"{whole}(?=/)|(?<=\w:){whole}"
        text = re.sub(whole, "${" + name + "}", text)
    return text


def origin(text: str, own: Mapping[str, str]) -> str:
    """What each ``${NAME}`` of `text` means and who says so, in brackets after a space; "" where there is none."""
    found = []
    for name in dict.fromkeys(_VARIABLE.findall(text)):
        if name in os.environ:
            found.append(f"{name} is {os.environ[name]}, from the environment")
        elif name in own:
            found.append(f"{name} is {own[name]}, from [variables]")
    return f" ({'; '.join(found)})" if found else ""
