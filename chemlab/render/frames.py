"""Frames of environments' ``render()``: arrays, or a window that shows the same frames."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
import numpy.typing as npt

from ..config.extras import needs
from .canvas import Image
from .draw import draw
from .scene import Scene

_SIZE = 960, 540
"""Width and height of a frame in pixels."""


class Viewer:
    """Shows an environment's scenes, one frame per call.

    Args:
        mode: ``rgb_array`` or ``human``.
        frames_per_second: maximum frame rate of a window.

    Raises:
        ImportError: Pillow (or pygame, for a window) is not installed; the message names the extra.
    """

    def __init__(self, mode: str, frames_per_second: float) -> None:
        self.mode = mode
        self.frames_per_second = frames_per_second
        self._pygame: Any = None
        if mode == "human":
            with needs("render_mode='human' needs pygame", "human"):
                import pygame
            self._pygame = pygame
        self._window: Any = None
        self._closed = False

    def show(self, scene: Scene) -> npt.NDArray[np.uint8] | None:
        """Return the frame [height, width, 3] in mode ``rgb_array``; in mode ``human`` show it and return None.

        After the user has closed the window, nothing more is shown.
        """
        frame = draw(scene, *_SIZE)
        if self._pygame is None:
            return frame
        if not self._closed:
            self._present(frame, f"chemlab: {scene.title}")
        return None

    def _present(self, frame: npt.NDArray[np.uint8], title: str) -> None:
        pygame = self._pygame
        if self._window is None or not pygame.display.get_init():  # a process has one window, which others may close
            pygame.display.init()
            self._window = pygame.display.set_mode(_SIZE)
            self._clock = pygame.time.Clock()
        pygame.display.set_caption(title)
        self._window.blit(pygame.image.frombuffer(frame.tobytes(), _SIZE, "RGB"), (0, 0))
        pygame.display.flip()
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            self._closed = True
            return
        self._clock.tick(self.frames_per_second)

    def close(self) -> None:
        """Close the window; the next frame opens it again."""
        if self._window is not None:
            self._window = None
            self._pygame.display.quit()

    def __reduce__(self) -> tuple[type[Viewer], tuple[str, float]]:
        # The window is not part of the state: a copied or pickled environment gets its own viewer.
        return Viewer, (self.mode, self.frames_per_second)


def picture_html(frame: npt.NDArray[np.uint8], name: str) -> str:
    """Return a picture as an HTML element, for notebooks."""
    data = io.BytesIO()
    Image.fromarray(frame).save(data, "png")
    return f'<img alt="{name}" src="data:image/png;base64,{base64.b64encode(data.getvalue()).decode()}">'
