"""What all figures that matplotlib draws have in common; it comes with the extra ``plot`` and is imported when used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..config.files import draft_of

__all__ = ["FORMATS", "SETTINGS", "import_matplotlib", "new_figure", "save_figure"]

FORMATS = ("png", "svg", "pdf")
SETTINGS: Any = {
    "font.size": 10.0,
    "axes.titlesize": 11.0,
    "legend.fontsize": 9.0,
    "figure.titlesize": 12.0,
    "text.parse_math": False,  # text comes from scenarios, and a dollar there is a dollar
    "svg.hashsalt": "chemlab",  # the same results make the same file
}
"""For ``matplotlib.rc_context``, around drawing and saving."""


def import_matplotlib() -> Any:
    """matplotlib.

    Raises:
        ImportError: it is not installed; the message names the extra.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise ImportError('figures need matplotlib: pip install ".[plot]"') from error
    return matplotlib


def new_figure(width: float, height: float) -> Any:
    """An empty figure, sizes in inches.

    Raises:
        ImportError: matplotlib is not installed.
    """
    import_matplotlib()
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=150)


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure in the format of the path's ending; what was there stays until the new one is whole.

    Raises:
        ValueError: unknown format, or larger than a picture may be.
        OSError: it cannot be written.
    """
    with draft_of(path) as draft:
        figure.savefig(draft, format=path.suffix.removeprefix("."))
