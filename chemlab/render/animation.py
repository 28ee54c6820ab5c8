"""A record as an animated picture."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from ..record import Record, RecordError, Replay
from .canvas import Image
from .draw import draw
from .scene import Scene, laboratory_scene

__all__ = ["animation"]

_MILLISECONDS = 250
_BEGINNING, _END = 1500, 4000
"""Milliseconds that the first and the last frame are shown."""


def animation(
    record: Record, form: str, trust: bool = False, frames: int = 80, size: tuple[int, int] = (960, 540)
) -> bytes:
    """Replay a record and return its scenes, with the true contents, as an animated picture.

    Args:
        record: a record, finished or not.
        form: ``gif`` or ``webp``.
        trust: allow imports of code that the record names.
        frames: maximum number of frames, which are evenly spaced over the turns.
        size: width and height in pixels.

    Raises:
        ImportError: Pillow is not installed (``pip install '.[plot]'``).
        RecordError: the record cannot be replayed here.
    """
    images = [Image.fromarray(draw(scene, *size)) for scene in _scenes(record, frames, trust)]
    milliseconds = [_BEGINNING, *[_MILLISECONDS] * (len(images) - 2), _END][-len(images) :]
    made = io.BytesIO()
    best: dict[str, dict[str, Any]] = {"gif": {"optimize": True}, "webp": {"quality": 70, "method": 4}}
    images[0].save(made, form, save_all=True, append_images=images[1:], duration=milliseconds, loop=0, **best[form])
    return made.getvalue()


def _scenes(record: Record, most: int, trust: bool) -> list[Scene]:
    """Return evenly spaced scenes, with the first and the last."""
    replay, count = Replay(record, trust), len(record.turns)
    chosen = {round(turn) for turn in np.linspace(0, count, max(min(most, count + 1), 1))} | {count}
    scenes = [laboratory_scene(replay.laboratories)]
    for number, turn in enumerate(record.turns, start=1):
        try:
            replay.play(turn)
        except (ValueError, TypeError) as error:
            raise RecordError(f"{record.path}: turn {number}: {error}") from error
        if number in chosen:
            scenes.append(laboratory_scene(replay.laboratories))
    return scenes
