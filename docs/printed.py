"""Write the output of a page's code into the page: ``python docs/printed.py [PAGE ...]``.

A ``text`` block right after a ``python`` block is the output of that block. Figures that it saves are copied to
``images``. Tests run the same code and compare (tests/test_sandbox.py, tests/test_catalogue.py).
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

__all__ = ["PAGES", "printed"]

HERE = Path(__file__).resolve().parent
PAGES = ("sandbox.md", *(f"chemist/{path.name}" for path in sorted((HERE / "chemist").glob("*.md"))))
"""Pages of this folder with such blocks."""
_BLOCKS = re.compile(r"(?P<code>```python\n(?P<source>(?:(?!```).)*)```\n\n```text\n)(?:(?!```).)*```", re.S)
_FILES = re.compile(r"```\w+\n# file: (?P<name>\S+)\n(?:(?!```).)*```", re.S)


def _run(source: str) -> str:
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(source, "<page>", "exec"), {"__name__": "__main__"})
    return said.getvalue()


def printed(page: str, images: Path | None = None) -> str:
    """Return the text of a page with the current output of its code; copy the figures that it saves to ``images``."""
    before = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for block in _FILES.finditer(page):
                Path(block["name"]).write_text(block[0].partition("\n")[2].removesuffix("```"), encoding="utf-8")
            text = _BLOCKS.sub(lambda found: f"{found['code']}{_run(found['source'])}```", page)
            for picture in Path(folder).glob("*.png") if images else ():
                shutil.copy(picture, images or "")
        finally:
            os.chdir(before)
    return text


if __name__ == "__main__":
    for name in sys.argv[1:] or PAGES:
        path = HERE / name
        path.write_text(printed(path.read_text(encoding="utf-8"), HERE / "images"), encoding="utf-8")
