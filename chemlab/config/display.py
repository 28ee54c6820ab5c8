"""Facts about an object as HTML, for notebooks; tables and names in Markdown."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence


def facts_html(title: str, facts: Mapping[str, object]) -> str:
    """Return a heading and a table of names and values; empty values are left out."""
    rows = "".join(
        f'<tr><th style="text-align:left">{html.escape(name)}</th>'
        f'<td style="text-align:left">{html.escape(str(value))}</td></tr>'
        for name, value in facts.items()
        if value not in ("", None)
    )
    return f"<b>{html.escape(title)}</b><table>{rows}</table>"


def inert(line: str) -> str:
    """Return a line of Markdown without the HTML and links that names in files of other people may hold."""
    return " ".join(line.splitlines()).replace("<", "&lt;").replace("](", "]\\(")


def markdown_table(columns: Mapping[str, bool], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table; ``columns`` is {heading: True to align it to the right, as numbers}."""
    rules = ["--:" if numeric else "---" for numeric in columns.values()]
    return [f"| {' | '.join(columns)} |", f"|{'|'.join(rules)}|", *(f"| {' | '.join(cells)} |" for cells in rows)]
