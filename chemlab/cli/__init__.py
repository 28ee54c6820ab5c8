"""The ``chemlab`` command."""

from __future__ import annotations

import io
import os
import sys

from . import audit, benchmark, chemistry, crossplay, evaluation, laboratory, plan, play, plot, records, training  # noqa: F401 - importing a module adds its commands
from .common import app

__all__ = ["app", "main"]


def main() -> None:
    """Entry point of the ``chemlab`` command."""
    if os.environ.get("COLUMNS") == "0":  # help would be shown in no columns
        del os.environ["COLUMNS"]
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name that a terminal cannot show is no error
            stream.reconfigure(errors="backslashreplace")
    app()
