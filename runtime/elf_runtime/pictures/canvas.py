"""The parts of pictures: panels, titles, colours, and drawing at sub-pixel places."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

Picture = npt.NDArray[np.uint8]
Color = tuple[int, int, int]

WHITE: Color = (255, 255, 255)
DARK: Color = (24, 24, 24)
_GAP = 6  # pixels between two panels
_SUBPIXEL_BITS = 4  # OpenCV draws at fixed-point coordinates
_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.55


def strength_colors(count: int) -> list[Color]:
    """`count` BGR colours from strong (yellow) to weak (violet): the bright part of PLASMA."""
    levels = np.linspace(255, 90, count).astype(np.uint8).reshape(-1, 1)
    return _bgr(cv2.applyColorMap(levels, cv2.COLORMAP_PLASMA)) if count else []


def distinct_colors(count: int) -> list[Color]:
    """`count` BGR colours, each far from the one before: hues in steps of the golden angle."""
    hues = (np.arange(count) * (137.508 / 2) % 180).astype(np.uint8)
    hsv = np.stack([hues, np.full_like(hues, 170), np.full_like(hues, 255)], axis=1)
    return _bgr(cv2.cvtColor(hsv[:, None], cv2.COLOR_HSV2BGR)) if count else []


def _bgr(column: npt.NDArray[np.uint8]) -> list[Color]:
    return [(int(b), int(g), int(r)) for b, g, r in column[:, 0]]


def titled(picture: Picture, text: str, counts: str = "", legend: bool = False) -> Picture:
    """`picture` under a dark strip with `text` and `counts`.  A text that does not fit loses its beginning.

    Parameters
    ----------
    counts : str
        Stands behind the text, and is cut only where it does not fit alone.
    legend : bool
        Explain the colours of `strength_colors` at the strip's right end, where there is room.
    """
    width = picture.shape[1]
    strip = np.full((30, width, 3), DARK, np.uint8)
    text = _fitted(drawable(text), drawable(f"  {counts}" if text and counts else counts), width - 16)
    write(strip, text, 8)
    bar, weak, strong = 80, text_width("weak"), text_width("strong")
    x = width - (weak + bar + strong + 24)
    if legend and x > text_width(text) + 24:
        write(strip, "weak", x)
        x += weak + 8
        strip[9:21, x : x + bar] = np.array(strength_colors(bar)[::-1], np.uint8)
        write(strip, "strong", x + bar + 8)
    return np.concatenate([strip, picture])


def drawable(text: str) -> str:
    """`text` as OpenCV can draw it, with ``?`` for control characters and for what is not Unicode."""
    whole = text.encode("utf-8", "replace").decode()
    return "".join(character if character.isprintable() else "?" for character in whole)


def _fitted(text: str, counts: str, width: int) -> str:
    """`text` and `counts` within `width` pixels: of the text only the end, behind dots, and cut if that is too long."""
    if text_width(text + counts) <= width:
        return text + counts
    while text and text_width("..." + text + counts) > width:
        text = text[1:]
    found = ("..." if text else "") + (text + counts if text else counts.lstrip())
    while found and text_width(found) > width:
        found = found[:-1]
    return found


def side_by_side(pictures: Sequence[Picture]) -> Picture:
    """Pictures in one row, aligned at the top, on a dark ground."""
    height = max(picture.shape[0] for picture in pictures)
    width = sum(picture.shape[1] for picture in pictures) + _GAP * (len(pictures) - 1)
    row = np.full((height, width, 3), DARK, np.uint8)
    x = 0
    for picture in pictures:
        row[: picture.shape[0], x : x + picture.shape[1]] = picture
        x += picture.shape[1] + _GAP
    return row


def stacked(rows: Sequence[Picture]) -> Picture:
    """Pictures below one another, aligned at the left, on a dark ground."""
    turned = side_by_side([np.ascontiguousarray(row.transpose(1, 0, 2)) for row in rows])
    return np.ascontiguousarray(turned.transpose(1, 0, 2))


def circle(picture: Picture, x: float, y: float, radius: float, color: Color, thickness: int) -> None:
    """A ring, or a disc where `thickness` is -1."""
    center = (_fixed(x), _fixed(y))
    cv2.circle(picture, center, _fixed(radius), color, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)


def line(
    picture: Picture,
    a: npt.NDArray[np.floating],
    b: npt.NDArray[np.floating],
    color: Color,
    thickness: int = 1,
) -> None:
    """A line from `a` to `b`, both (x, y)."""
    ends = [(_fixed(x), _fixed(y)) for x, y in (a, b)]
    cv2.line(picture, ends[0], ends[1], color, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)


def _fixed(value: float) -> int:
    return round(float(value) * (1 << _SUBPIXEL_BITS))


def text_width(text: str) -> int:
    """In pixels."""
    return int(cv2.getTextSize(text, _FONT, _FONT_SCALE, 1)[0][0])


def write(picture: Picture, text: str, x: int, y: int = 20, color: Color = WHITE) -> None:
    """A line of text that begins at `x` and stands on `y`."""
    cv2.putText(picture, text, (x, y), _FONT, _FONT_SCALE, color, 1, cv2.LINE_AA)
