"""Options and output of the scripts in this folder: figures as JSON, tables as Markdown, tables of documents."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from chemlab.config.files import replace_between


def arguments(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Return the arguments of a script that has ``--json`` and ``--update``, too."""
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--update", type=Path, nargs="+", default=[], metavar="FILE", help="Markdown files whose tables are replaced"
    )
    return parser.parse_args()


def report(given: argparse.Namespace, figures: Any, tables: Mapping[str, Sequence[str]]) -> None:
    """Print figures as JSON or the lines of tables, and replace the tables of documents.

    Args:
        given: the script's :func:`arguments`.
        figures: what was measured.
        tables: Markdown, by the mark of its place in a document. Of several, a document gets those whose marks it has.
    """
    print(json.dumps(figures, indent=1) if given.json else "\n\n".join("\n".join(lines) for lines in tables.values()))
    for file in given.update:
        text = file.read_text(encoding="utf-8")
        for mark in [mark for mark in tables if f"<!-- {mark}: begin -->" in text] or tables:
            replace_between(file, mark, list(tables[mark]))
