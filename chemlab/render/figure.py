"""What all figures that matplotlib draws have in common; it comes with the extra ``plot`` and is imported when used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

__all__ = ["FORMATS", "SETTINGS", "import_matplotlib", "new_figure", "save_figure"]

FORMATS = ("png", "svg", "pdf")
SETTINGS: Any = {
    "font.size": 10.0,
    "axes.titlesize": 11.0,
    "legend.fontsize": 9.0,
    "figure.titlesize": 12.0,
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
        raise ImportError('figures need matplotlib: pip install "chemlab-marl[plot]"') from error
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
        ValueError: unknown format.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.stem}.draft{path.suffix}")
    try:
        figure.savefig(draft)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
