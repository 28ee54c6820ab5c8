"""A canvas that records the position of every text and caches rendered text."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from ..config.extras import needs

with needs("pictures need Pillow", "plot"):
    from PIL import Image, ImageDraw, ImageFont

__all__ = ["Box", "Canvas", "Image", "ImageDraw", "TextBox", "text_width"]

_DOTS = "..."
_FINER = 4
"""Factor by which texts are drawn larger before they are reduced."""


class Box(NamedTuple):
    """A rectangle in pixels; ``right`` and ``bottom`` are exclusive."""

    left: int
    top: int
    right: int
    bottom: int


class TextBox(NamedTuple):
    """Bounding box of a text's ink."""

    text: str
    box: Box


@functools.lru_cache(maxsize=32)
def _font(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    if not isinstance(font, ImageFont.FreeTypeFont):  # Pillow built without FreeType has a single bitmap font
        raise ImportError("pictures need a Pillow with FreeType support; pip's has it: pip install pillow")
    return font


@functools.lru_cache(maxsize=4096)
def _ink(text: str, size: int) -> tuple[Image.Image, int, int]:
    """Return the grey image of a text's ink and its offset from the start of the baseline.

    The text is drawn larger and then reduced, because the font's hinting spaces small letters unevenly.
    """
    left, top, right, bottom = (int(value) for value in _font(size * _FINER).getbbox(text, anchor="ls"))
    # Align the ink box to whole pixels, so that the baseline stays on a pixel boundary.
    left, top = math.floor(left / _FINER), math.floor(top / _FINER)
    right, bottom = max(math.ceil(right / _FINER), left + 1), max(math.ceil(bottom / _FINER), top + 1)
    large = Image.new("L", ((right - left) * _FINER, (bottom - top) * _FINER))
    start = (-left * _FINER, -top * _FINER)
    ImageDraw.Draw(large).text(start, text, fill=255, font=_font(size * _FINER), anchor="ls")
    return large.resize((right - left, bottom - top), Image.Resampling.BOX), left, top


@functools.lru_cache(maxsize=4096)
def text_width(text: str, size: int) -> int:
    """Return the width in pixels of a text set at ``size`` pixels."""
    return math.ceil(_font(size * _FINER).getlength(text) / _FINER)


@functools.lru_cache(maxsize=4096)
def _fitted(text: str, size: int, room: int) -> str:
    """Truncate a text with an ellipsis so that it fits ``room`` pixels; return an empty string if nothing fits."""
    if text_width(text, size) <= room:
        return text
    for end in range(len(text) - 1, 0, -1):
        shorter = text[:end].rstrip() + _DOTS
        if text_width(shorter, size) <= room:
            return shorter
    return ""


class Canvas:
    """An RGB image that keeps a list of its texts.

    Coordinates are in units of ``scale`` pixels. Colours are ``#rrggbb``.
    """

    def __init__(self, image: Image.Image, scale: float, texts: Iterable[TextBox] = ()) -> None:
        self.image = image
        self.scale = scale
        self.texts = list(texts)
        self.pen = ImageDraw.Draw(image)

    def px(self, units: float) -> int:
        """Convert units to whole pixels."""
        return round(units * self.scale)

    def text(
        self,
        x: float,
        baseline: float,
        text: str,
        size: float = 10.0,
        color: str = "#1b2733",
        align: str = "left",
        room: float | None = None,
    ) -> float:
        """Draw one line of text, truncated to ``room`` units, and return its width in units.

        ``align`` names the anchor at ``x``: ``left``, ``center`` or ``right``.
        """
        pixels = max(self.px(size), 5)
        if room is not None:
            text = _fitted(text, pixels, max(int(room * self.scale), 0))
        if not text.strip():
            return 0.0
        ink, left, top = _ink(text, pixels)
        width = text_width(text, pixels)
        at = self.px(x) - {"left": 0, "center": width // 2, "right": width}[align] + left
        y = self.px(baseline) + top
        self.image.paste(color, (at, y), ink)
        self.texts.append(TextBox(text, Box(at, y, at + ink.width, y + ink.height)))
        return width / self.scale

    def rectangle(
        self, left: float, top: float, right: float, bottom: float, fill: str | None, outline: str | None = None
    ) -> None:
        """Draw a rectangle of at least one pixel between two corners."""
        x, y = self.px(left), self.px(top)
        box = x, y, max(self.px(right) - 1, x), max(self.px(bottom) - 1, y)
        self.pen.rectangle(box, fill=fill, outline=outline)

    def card(
        self,
        left: float,
        top: float,
        right: float,
        bottom: float,
        fill: str,
        outline: str,
        radius: float = 5.0,
        width: int = 1,
    ) -> None:
        """Draw a rectangle with rounded corners."""
        box = self.px(left), self.px(top), self.px(right) - 1, self.px(bottom) - 1
        self.pen.rounded_rectangle(box, self.px(radius), fill, outline, width)

    def line(self, points: Sequence[tuple[float, float]], color: str, width: int = 1) -> None:
        """Draw a polyline."""
        self.pen.line([(x * self.scale, y * self.scale) for x, y in points], fill=color, width=width)

    def bar(self, left: float, top: float, right: float, bottom: float, share: float, color: str, track: str) -> None:
        """Draw a horizontal bar filled to ``share``."""
        self.rectangle(left, top, right, bottom, track)
        end = left + (right - left) * min(max(share, 0.0), 1.0)
        if self.px(end) > self.px(left):
            self.rectangle(left, top, end, bottom, color)

    def stack(self, left: float, top: float, right: float, bottom: float, parts: Sequence[tuple[float, str]]) -> None:
        """Draw a horizontal bar of adjacent (share, colour) segments."""
        at = left
        for share, color in parts:
            end = min(at + (right - left) * share, right)
            if self.px(end) > self.px(at):
                self.rectangle(at, top, end, bottom, color)
            at = end
