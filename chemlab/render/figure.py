"""Common parts of all matplotlib figures. Matplotlib (extra ``plot``) is imported on first use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..config.extras import needs
from ..config.files import draft_of

FORMATS = ("png", "svg", "pdf")
SETTINGS: Any = {
    "font.size": 10.0,
    "axes.titlesize": 11.0,
    "legend.fontsize": 9.0,
    "figure.titlesize": 12.0,
    "text.parse_math": False,  # scenario texts may contain dollar signs
    "svg.hashsalt": "chemlab",  # identical results give identical files
}
"""Settings for ``matplotlib.rc_context`` while drawing and saving."""


def import_matplotlib() -> Any:
    """Import and return matplotlib.

    Raises:
        ImportError: matplotlib is not installed; the message names the extra.
    """
    with needs("figures need matplotlib", "plot"):
        import matplotlib
    return matplotlib


def new_figure(width: float, height: float) -> Any:
    """Create an empty figure; sizes are in inches.

    Raises:
        ImportError: matplotlib is not installed.
    """
    import_matplotlib()
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=150)


def check_format(path: Path) -> None:
    """Check that a path has the suffix of a picture.

    Raises:
        ValueError: it has another suffix, or none.
    """
    if path.suffix.removeprefix(".") not in FORMATS:
        raise ValueError(f"{path}: unknown suffix {path.suffix or 'none'}; choose from {', '.join(FORMATS)}")


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure in the format of the path's suffix; an existing file is replaced when the new one is complete.

    Raises:
        ValueError: the format is unknown, or the figure exceeds the largest picture size.
        OSError: the file cannot be written.
    """
    check_format(path)
    with import_matplotlib().rc_context(SETTINGS), draft_of(path) as draft:
        figure.savefig(draft, format=path.suffix.removeprefix("."))
