"""The ``chemlab`` command."""

from __future__ import annotations

from . import audit, benchmark, chemistry, crossplay, evaluation, laboratory, plan, play, plot, records, training  # noqa: F401 - importing a module adds its commands
from .common import app

__all__ = ["app", "main"]


def main() -> None:
    """Entry point of the ``chemlab`` command."""
    app()
