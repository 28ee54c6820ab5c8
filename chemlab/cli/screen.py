"""Terminal output: consoles that print text from files verbatim, and tables that do not break words."""

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

_NARROWEST, _USUAL = 20, 80
"""Minimum width in columns, and the width that is assumed if the terminal reports none."""
_NOISE = 1e-9
"""Safety events below this amount (in their own unit) are rounding errors."""


class TextConsole(Console):
    """A console that shows control characters of texts as visible signs and prints ``:words:`` verbatim.

    Styles of the message itself are kept.
    """

    def __init__(self, *, stderr: bool = False, soft_wrap: bool = False) -> None:
        super().__init__(stderr=stderr, soft_wrap=soft_wrap, highlight=False, emoji=False)
        if self.width < _NARROWEST:  # a width of 0 would show nothing
            self.width = _NARROWEST if self.width else _USUAL

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """See :meth:`rich.console.Console.render`."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(segment.text.translate(_SIGNS), segment.style)


class _Signs(dict[int, int]):
    """Table for ``str.translate``: control and invisible formatting characters become signs of one column."""

    def __missing__(self, code: int) -> int:
        steers = unicodedata.category(chr(code)) in ("Cc", "Cf", "Cs", "Zl", "Zp") and chr(code) not in "\n\t"
        # Unicode has control pictures for codes below 32.
        self[code] = (0x2400 + code if code < 32 else 0xFFFD) if steers else code
        return self[code]


_SIGNS = _Signs()

# Commands print messages to standard error if standard output is read by a program.
out = TextConsole(soft_wrap=True)
err = TextConsole(stderr=True, soft_wrap=True)
page = TextConsole()
"""Standard output, fitted to the terminal's width."""


def plain(text: object) -> str:
    """Escape text from files or users for use in a message with markup."""
    return escape(str(text).translate(_SIGNS))


def hanging(head: str, body: str) -> None:
    """Print a line with markup; in a terminal, continuation lines are indented to the start of the body."""
    line = Text.from_markup(head + body)
    indent = cell_len(Text.from_markup(head).plain)
    if not out.is_terminal or out.width < 2 * indent:
        out.print(line)
        return
    first, *rest = line.wrap(out, out.width)
    out.print(first)
    if rest:
        below = Text(" ").join(rest)
        for part in below.wrap(out, out.width - indent):
            out.print(Text(" " * indent) + part)


def safety_words(events: Mapping[str, float], amounts: bool = True) -> list[str]:
    """Describe the safety events that happened, with or without their amounts."""
    from ..lab.text import event_words

    described = [event_words(kind, amount) for kind, amount in events.items() if amount >= _NOISE]
    return [" ".join(one) if amounts else one[0] for one in described]


def show_table(title: str, head: Sequence[str], rows: Iterable[Sequence[object]], right: Iterable[int] = ()) -> None:
    """Print a table that fits the terminal.

    Cells are broken between words only. If the longest words do not fit side by side, every row is printed as a
    paragraph.

    Args:
        title: title above the table; may be empty.
        head: names of the columns.
        rows: cells, printed verbatim (without markup), or ``Text`` with a style.
        right: right-aligned columns (numbers).
    """
    # Translate here, because control characters count as zero columns when widths are computed.
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
    """Return a width for each column, at least that of its longest word; None if they do not fit.

    The first column, which names the row, is not broken if the others leave enough room.
    """
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
            grid.add_column(overflow="fold")  # never drop letters
        for name, cell in zip(head, row, strict=True):
            grid.add_row(Text(f"  {name}:"), cell)
        page.print(grid)
        page.print()


def counting() -> Progress:
    """Return a progress line "done of total" on a terminal's standard error, which disappears at the end."""
    parts = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    return Progress(*parts, console=err, transient=True, disable=not err.is_interactive)
