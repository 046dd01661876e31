"""The page as a file: style, script and data in one, image by image, so that memory holds one of them at a time."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import zlib
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.errors import printable
from elf_runtime.files.write import write_atomically

from .shown import ScoreMap, Shown

MARK = "<!doctype html>\n<!-- elf-view -->\n"
_SCRIPTS = ("keypoints.js", "matching.js", "drawing.js", "view.js")
_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 85]
_THUMBNAIL = 160  # pixels of its longer side


def write_page(path: Path, title: str, images: Iterable[Shown]) -> None:
    """Write the page; what was there stays where it fails.

    Nothing in it is loaded from elsewhere, and its security policy forbids the browser to: only this very script runs.
    """

    def write(part: Path) -> None:
        with open(part, "w", encoding="utf-8", newline="\n") as file:
            file.write(_head(title))
            for image in images:
                file.write(f'<script type="application/json" class="image">{_json(_data(image))}</script>\n')
            file.write(f"<script>{script()}</script>\n</body>\n</html>\n")

    write_atomically(path, write)


def is_page(path: Path) -> bool:
    """Whether a file is one that `write_page` wrote."""
    try:
        with open(path, "rb") as file:
            return file.read(len(MARK)) == MARK.encode()
    except OSError:
        return False


def script() -> str:
    """The page's script."""
    return "\n".join(_part(name) for name in _SCRIPTS)


def _head(title: str) -> str:
    allowed = base64.b64encode(hashlib.sha256(script().encode()).digest()).decode()
    policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{allowed}'"
    page = _part("page.html").replace("{policy}", policy).replace("{style}", _part("page.css"))
    return MARK + page.replace("{title}", html.escape(printable(title)))


def _part(name: str) -> str:
    return (files("elf_runtime.view") / "page" / name).read_text(encoding="utf-8")


def _json(data: dict[str, Any]) -> str:
    """JSON that ends no script element, whatever a name holds."""
    return json.dumps(data, allow_nan=False).replace("<", "\\u003c")


def _data(image: Shown) -> dict[str, Any]:
    features = image.features
    return {
        "name": printable(image.name),
        "note": image.note,
        "size": list(features.image_size),
        "picture": None if image.picture is None else _jpeg(image.picture),
        "thumbnail": None if image.picture is None else _jpeg(_thumbnail(image.picture)),
        "candidates": {
            "count": len(features),
            "places": _base64(features.keypoints.astype("<f4")),
            "scores": _base64(features.scores.astype("<f4")),
            "sizes": _base64(features.sizes.astype("<f4")),
            "descriptors": _base64(features.descriptors),
            "dim": features.descriptors.shape[1],
        },
        "map": None if image.map is None else _map(image.map),
    }


def _map(map_: ScoreMap) -> dict[str, Any]:
    """Scores and permission are deflated: rows of uint16, little end first; bits, the highest of a byte first."""
    params = map_.params
    return {
        "size": list(map_.scores.shape),
        "scores": _base64(zlib.compress(map_.scores.astype("<u2").tobytes())),
        "permitted": _base64(zlib.compress(np.packbits(map_.permitted).tobytes())),
        "step": map_.step,
        "level": map_.level,
        "radii": list(map_.radii),
        "radius": params.nms_radius,
        "count": params.max_keypoints,
        "maximaOnly": params.suppression == "maxima",
    }


def _thumbnail(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    height, width = picture.shape[:2]
    factor = min(1.0, _THUMBNAIL / max(height, width))
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def _jpeg(picture: npt.NDArray[np.uint8]) -> str:
    return "data:image/jpeg;base64," + _base64(cv2.imencode(".jpg", picture, _JPEG)[1])


def _base64(data: npt.NDArray[Any] | bytes) -> str:
    return base64.b64encode(data if isinstance(data, bytes) else np.ascontiguousarray(data).tobytes()).decode()
