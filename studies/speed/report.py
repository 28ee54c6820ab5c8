"""Options and output of the scripts in this folder: figures as JSON, tables as Markdown, tables of documents."""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Callable, Mapping, Sequence
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


def children_seconds(run: Callable[[], object]) -> tuple[float, float]:
    """Return s of wall time of a call, and s of processor time of the processes that it starts."""
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    run()
    wall, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


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
