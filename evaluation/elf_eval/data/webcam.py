"""Webcam sequences (TILDE's layout): a fixed camera, so that the ground truth is the identity.

root/Chamonix/*.jpg,  or  root/Chamonix/test/image_color/*.png
"""

from __future__ import annotations

from pathlib import Path

from elf_eval.errors import EvalError
from elf_eval.spec import Spec, comma_separated

from .dataset import Dataset, Pair
from .files import folders_in, images_to_pair, is_image, scene_name
from .images import ImageRef
from .truth import Homography

_INNER = ("test/image_color", "test/image_gray", "test/image_grey")


def webcam(spec: Spec) -> Dataset:
    """``webcam:FOLDER``; options ``scenes=a,b`` and ``limit=N``, which takes only the first N images of a scene.

    The first image of a scene, in natural order of the names, against each other one.  A FOLDER without
    folders in it is one scene.

    Raises
    ------
    EvalError
        Also where a scene has no image or only one.
    """
    limit = spec.take("limit", _at_least_two, None)
    pairs: list[Pair] = []
    root = spec.folder()
    wanted = comma_separated(spec.take("scenes", str, ""))
    scenes = folders_in(root) or [root]
    for name in sorted(set(wanted) - {scene_name(folder) for folder in scenes}):
        with spec.whole(name):
            raise EvalError(f"{root}: no scene {name!r}; there are {[scene_name(f) for f in scenes]}")
    for scene in scenes:
        if wanted and scene_name(scene) not in wanted:
            continue
        name = scene_name(scene)
        with spec.whole(name):
            refs = [ImageRef(f"{name}/{p.name}", p) for p in images_to_pair(_image_folder(scene))[:limit]]
            pairs += [Pair(name, refs[0], other, Homography()) for other in refs[1:]]
    return Dataset("webcam", tuple(pairs))


def _at_least_two(text: str) -> int:
    number = int(text)
    if number < 2:
        raise ValueError("a scene's pairs need two images")
    return number


def _image_folder(scene: Path) -> Path:
    if any(is_image(p) for p in scene.iterdir()):
        return scene
    return next((scene / inner for inner in _INNER if (scene / inner).is_dir()), scene)
