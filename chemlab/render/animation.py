"""Animated pictures and videos of records."""

from __future__ import annotations

import io
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..config.scenario import Scenario
from ..record import Record, RecordError, Replay
from .canvas import Image
from .draw import draw
from .scene import Scene, laboratory_scene

_MILLISECONDS = 250
_BEGINNING, _END = 1500, 4000
"""Milliseconds that the first and the last frame are shown."""


def animation(
    record: Record,
    form: str,
    trust: bool = False,
    frames: int = 80,
    size: tuple[int, int] = (960, 540),
    scenario: Scenario | None = None,
) -> bytes:
    """Replay a record and return its scenes, with the true contents, as an animated picture, or as a video.

    Args:
        record: a record, finished or not.
        form: ``gif``, ``webp``, or ``mp4`` (needs the program ffmpeg).
        trust: allow imports of code that the record names.
        frames: maximum number of frames, which are evenly spaced over the turns.
        size: width and height in pixels.
        scenario: custom parts are looked for in the folder of its file; None: in the record's folder.

    Raises:
        ImportError: Pillow is not installed (``pip install '.[plot]'``).
        ValueError: a video is requested, and ffmpeg is not installed.
        RecordError: the record cannot be replayed here.
    """
    images = [
        Image.fromarray(draw(scene, *size)) for scene in _scenes(record, frames, Replay(record, trust, beside=scenario))
    ]
    milliseconds: list[int] = [_BEGINNING, *[_MILLISECONDS] * (len(images) - 2), _END][-len(images) :]
    if form == "mp4":
        return _video(images, milliseconds)
    content = io.BytesIO()
    options: dict[str, dict[str, Any]] = {"gif": {"optimize": True}, "webp": {"quality": 70, "method": 4}}
    images[0].save(
        content, form, save_all=True, append_images=images[1:], duration=milliseconds, loop=0, **options[form]
    )
    return content.getvalue()


def _video(images: Sequence[Any], milliseconds: Sequence[int]) -> bytes:
    """Encode frames with ffmpeg."""
    program = shutil.which("ffmpeg")
    if program is None:
        raise ValueError("a video needs the program ffmpeg; install it, or name a .gif or .webp")
    pixels = [
        image.tobytes() for image, time in zip(images, milliseconds, strict=True) for _ in range(time // _MILLISECONDS)
    ]
    size = "x".join(map(str, images[0].size))
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(1000 // _MILLISECONDS), "-i", "-"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        command = [program, "-loglevel", "error", *source, "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
        subprocess.run(command, input=b"".join(pixels), check=True)
        return path.read_bytes()


def _scenes(record: Record, most: int, replay: Replay) -> list[Scene]:
    """Return at most ``most`` evenly spaced scenes (at least two), the first and the last included."""
    count = len(record.turns)
    chosen = {round(turn) for turn in np.linspace(0, count, max(min(most, count + 1), 1))} | {count}
    scenes = [laboratory_scene(replay.laboratories)]
    for number, turn in enumerate(record.turns):
        try:
            replay.play(turn)
        except (ValueError, TypeError) as error:
            raise RecordError(f"{record.path}: turn {number}: {error}") from error
        if number + 1 in chosen:
            scenes.append(laboratory_scene(replay.laboratories))
    return scenes
