"""Rendering common to every environment: text, a picture, or the picture in a window."""

from __future__ import annotations

import html
from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from ..config.scenario import Scenario
    from ..render.scene import Scene

RENDER_MODES = ("ansi", "rgb_array", "rgb_array_true", "human")
"""Render modes. With hidden parameters, ``rgb_array_true`` shows true contents; the others only fill levels and what
agents observe.
"""


class Rendered:
    """Mixin of environments with rendering; subclasses provide text and scene."""

    metadata: dict[str, Any]
    render_mode: str | None
    scenario: Scenario
    _viewer: Any = None

    def _set_render_mode(self, mode: str | None) -> None:
        if mode is not None and mode not in RENDER_MODES:
            raise ValueError(f"render_mode must be one of {list(RENDER_MODES)} or None, given {mode!r}")
        self.render_mode = mode

    @abstractmethod
    def _text(self) -> str:
        """Return the text of the render mode ``ansi``."""

    @abstractmethod
    def _scene(self) -> Scene:
        """Return the current scene, with true contents."""

    def _show(self) -> None:
        """Update the window after every reset and step."""
        if self.render_mode == "human":
            self.render()

    def render(self) -> Any:  # versions of Gymnasium declare different types
        """Return a text (mode ``ansi``) or a picture [540, 960, 3] (``rgb_array``), or show it in a window (``human``).

        In a scenario with hidden parameters these show only fill levels, as the shelf's gauge reads them, and what the
        agents observe.
        ``rgb_array_true`` shows the true contents.

        Raises:
            ImportError: Pillow, or for a window pygame, is not installed; the message names the extra.
        """
        if self.render_mode is None:
            gymnasium.logger.warn(f"render() was called without a render_mode; pass one of {', '.join(RENDER_MODES)}.")
            return None
        if self.render_mode == "ansi":
            return self._text()
        from ..render.frames import Viewer
        from ..render.scene import visible_scene

        if self._viewer is None:
            self._viewer = Viewer(self.render_mode, self.metadata["render_fps"])
        frame: npt.NDArray[np.uint8] | None = self._viewer.show(
            self._scene() if self.render_mode == "rgb_array_true" else visible_scene(self._scene(), self.scenario)
        )
        return frame

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the picture of :meth:`render`."""
        text = f"<pre>{html.escape(repr(self))}</pre>"
        try:
            from ..render.frames import Viewer, picture_html
            from ..render.scene import visible_scene
        except ImportError:  # Pillow is an extra
            return text
        frame = Viewer("rgb_array", 1.0).show(visible_scene(self._scene(), self.scenario))
        assert frame is not None
        return picture_html(frame, f"The laboratory {html.escape(self.scenario.name)}") + text

    def close(self) -> None:
        """Close the window if there is one."""
        if self._viewer is not None:
            self._viewer.close()
