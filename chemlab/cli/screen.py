"""What people see: consoles that show text from files as it is, and tables that break no word."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Mapping, Sequence

from rich.box import SIMPLE
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

__all__ = ["TextConsole", "counting", "err", "event_words", "happened", "out", "page", "plain", "show_table"]

_NARROWEST, _USUAL = 20, 80
"""Columns of text below which a terminal's word is not taken, and where it says none."""
_NOISE = 1e-9
"""Safety events below this (mol, L or whatever they are in) are what rounding leaves of none."""


class TextConsole(Console):
    """A console on which text can do nothing but be read: characters that would steer the terminal are shown as signs,
    ``:words:`` stay words. What a message's own style does is not touched."""

    def __init__(self, *, stderr: bool = False, soft_wrap: bool = False) -> None:
        super().__init__(stderr=stderr, soft_wrap=soft_wrap, highlight=False, emoji=False)
        if self.width < _NARROWEST:  # where it is 0, nothing would be shown at all
            self.width = _NARROWEST if self.width else _USUAL

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """See :meth:`rich.console.Console.render`."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(segment.text.translate(_SIGNS), segment.style)


class _Signs(dict[int, int]):
    """For ``str.translate``: control and invisible formatting characters as signs of one column."""

    def __missing__(self, code: int) -> int:
        steers = unicodedata.category(chr(code)) in ("Cc", "Cf", "Cs", "Zl", "Zp") and chr(code) not in "\n\t"
        # Below 32 Unicode has a picture of each.
        self[code] = (0x2400 + code if code < 32 else 0xFFFD) if steers else code
        return self[code]


_SIGNS = _Signs()

# Text for people goes where it can be read without spoiling what a program reads from standard output.
out = TextConsole(soft_wrap=True)
err = TextConsole(stderr=True, soft_wrap=True)
page = TextConsole()
"""Standard output, for what is fitted to the terminal's width."""


def plain(text: object) -> str:
    """Text from files and of people, to stand in a message with markup: brackets in it are brackets."""
    return escape(str(text).translate(_SIGNS))


def happened(events: Mapping[str, float]) -> dict[str, float]:
    """Safety events, without what rounding leaves of none."""
    return {kind: amount for kind, amount in events.items() if amount >= _NOISE}


def event_words(events: Mapping[str, float]) -> list[str]:
    """Safety events that happened, with their amounts."""
    return [f"{kind} {amount:.3g}" for kind, amount in happened(events).items()]


def show_table(title: str, head: Sequence[str], rows: Iterable[Sequence[object]], right: Iterable[int] = ()) -> None:
    """Print a table as wide as the terminal at most. Cells are broken between words only; where the longest words do
    not fit beside each other, every row becomes a paragraph.

    Args:
        title: above it; nothing where it is empty.
        head: names of the columns.
        rows: cells, shown as they are (markup is none here), or ``Text`` with a style.
        right: columns that stand flush right (numbers).
    """
    # Signs are put in here already: what steers a terminal counts as no column when widths are worked out.
    cells = [[cell if isinstance(cell, Text) else Text(str(cell).translate(_SIGNS)) for cell in row] for row in rows]
    flush = set(right)
    if title:
        page.print(Text(title, style="italic"))
    for gap in (2, 1):
        widths = _widths([[Text(name) for name in head], *cells], page.width - 2 - gap * (len(head) - 1))
        if widths is not None:
            table = Table(box=SIMPLE, padding=(0, gap - 1, 0, 0), pad_edge=False)
            for i, (name, width) in enumerate(zip(head, widths, strict=True)):
                table.add_column(Text(name), width=width, justify="right" if i in flush else "left", overflow="fold")
            for row in cells:
                table.add_row(*row)
            page.print(table)
            return
    _paragraphs(head, cells)


def _widths(rows: Sequence[Sequence[Text]], most: int) -> list[int] | None:
    """A width for each column, none below its longest word; None if that is more than there is. The first column, which
    says what a row is of, is not broken at all where the others leave it the room."""
    columns = list(zip(*rows, strict=True))
    widths = [max(cell_len(line) for cell in column for line in cell.plain.splitlines() or [""]) for column in columns]
    least = [max(cell_len(word) for cell in column for word in cell.plain.split() or [""]) for column in columns]
    if sum(least) > most:
        return None
    if widths[0] + sum(least[1:]) <= most:
        least[0] = widths[0]
    while sum(widths) > most:
        widest = max((i for i in range(len(widths)) if widths[i] > least[i]), key=lambda i: widths[i])
        widths[widest] -= 1
    return widths


def _paragraphs(head: Sequence[str], rows: Sequence[Sequence[Text]]) -> None:
    for row in rows:
        grid = Table.grid(padding=(0, 1))
        for _ in range(2):
            grid.add_column(overflow="fold")  # no letter is left out
        for name, cell in zip(head, row, strict=True):
            grid.add_row(Text(f"  {name}:"), cell)
        page.print(grid)
        page.print()


def counting() -> Progress:
    """A line of progress with how many are done of how many, on standard error; it is gone when they all are."""
    parts = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    return Progress(*parts, console=err, transient=True)
