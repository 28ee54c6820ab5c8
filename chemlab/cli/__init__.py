"""The ``chemlab`` command."""

from __future__ import annotations

import io
import os
import sys
from typing import Any

from . import (  # noqa: F401 - importing a module adds its commands
    auditing,
    benchmarking,
    check,
    chemicals,
    evaluation,
    exporting,
    laboratories,
    partners,
    playing,
    plot,
    records,
    servers,
    training,
)
from .options import app

__all__ = ["PANELS", "app", "main"]

PANELS: dict[str, tuple[str, ...]] = {
    "Play": ("run", "play", "serve", "mcp", "list", "describe", "warm"),
    "Train": ("train", "sweep", "export"),
    "Compare": ("evaluate", "benchmark", "crossplay", "audit"),
    "Author": ("check", "new", "data"),
    "Records": ("verify", "replay", "plot"),
}
"""Panels of ``chemlab --help`` with their commands, in the order of display."""


def _arrange() -> None:
    """Sort the commands into their panels."""
    order = [(name, panel) for panel, names in PANELS.items() for name in names]
    panels, names = dict(order), [name for name, _ in order]

    def place(command: Any) -> int:
        name = command.name or command.callback.__name__
        command.rich_help_panel = panels[name]
        return names.index(name)

    app.registered_commands.sort(key=place)
    app.registered_groups.sort(key=place)


_arrange()


def main() -> None:
    """Entry point of the ``chemlab`` command."""
    if os.environ.get("COLUMNS") == "0":  # help would be shown in no columns
        del os.environ["COLUMNS"]
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name that a terminal cannot show is no error
            stream.reconfigure(errors="backslashreplace")
    app()
