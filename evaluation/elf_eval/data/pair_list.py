"""Lists of calibrated pairs in the format of SuperGlue's pair files.

Each line is ``name1 name2 turns1 turns2 K1 (9) K2 (9) T (16)``.  So many quarter turns, counter-clockwise, bring an
image upright; T is (4, 4), from camera 1 to camera 2.  K and T belong to the files as they are stored.
"""

from __future__ import annotations

from pathlib import Path

from elf_eval.errors import EvalError
from elf_eval.spec import Spec

from .dataset import Dataset, Pair
from .files import scene_name
from .images import ImageRef
from .truth import Calibrated

_FIELDS = 38


def pair_list(spec: Spec) -> Dataset:
    """``pairs:FILE``; option ``images=FOLDER``, by default the folder of FILE.

    A name's folder is its scene; names without one belong to a scene called like the folder of the images.
    """
    listing = spec.file("pairs file")
    root = Path(spec.take("images", str, str(listing.parent))).expanduser()
    pairs = []
    for number, line in enumerate(listing.read_text(encoding="utf-8").splitlines(), start=1):
        if line.strip():
            pairs.append(_pair(line.split(), root, f"{listing}:{number}"))
    if not pairs:
        raise EvalError(f"{listing}: no pairs in it")
    return Dataset("pairs", tuple(pairs))


def _pair(fields: list[str], root: Path, where: str) -> Pair:
    if len(fields) != _FIELDS:
        raise EvalError(f"{where}: expected {_FIELDS} fields (names, turns, K1, K2, T), found {len(fields)}")
    try:
        turns = [int(text) for text in fields[2:4]]
        numbers = [float(text) for text in fields[4:]]
    except ValueError as error:
        raise EvalError(f"{where}: {error}") from error
    refs = []
    for name, turn in zip(fields[:2], turns, strict=True):
        if not (root / name).is_file():
            raise EvalError(f"{where}: no such image: {root / name} (say images=FOLDER)")
        refs.append(ImageRef(name, root / name, quarter_turns=turn))
    truth = Calibrated(tuple(numbers[:9]), tuple(numbers[9:18]), tuple(numbers[18:]))
    inner = Path(fields[0]).parent.as_posix()
    return Pair(scene_name(root) if inner == "." else inner, refs[0], refs[1], truth)
