"""Write the output of a page's code into the page: ``python docs/printed.py [PAGE ...]``.

A ``text`` block right after a ``python`` block is the output of that block. Tests run the same code and compare
(tests/test_sandbox.py).
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
from pathlib import Path

__all__ = ["PAGES", "printed"]

PAGES = ("sandbox.md",)
"""Pages of this folder with such blocks."""
_BLOCKS = re.compile(r"(?P<code>```python\n(?P<source>(?:(?!```).)*)```\n\n```text\n)(?:(?!```).)*```", re.S)


def _run(source: str) -> str:
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(source, "<page>", "exec"), {"__name__": "__main__"})
    return said.getvalue()


def printed(page: str) -> str:
    """Return the text of a page with the current output of its code."""
    return _BLOCKS.sub(lambda found: f"{found['code']}{_run(found['source'])}```", page)


if __name__ == "__main__":
    for name in sys.argv[1:] or PAGES:
        path = Path(__file__).parent / name
        path.write_text(printed(path.read_text(encoding="utf-8")), encoding="utf-8")
