<<<<<<< HEAD
"""Write the output of a page's code into the page: ``python docs/printed.py [PAGE ...]``.

A ``text`` block right after a ``python`` block is the output of that block. Tests run the same code and compare
(tests/test_sandbox.py).
=======
"""Put what a page's code prints, and the pictures that it draws, into the pages: ``python docs/printed.py [PAGE ...]``.

A ``text`` block right after a ``python`` block is what that one prints. Pictures go to ``images``. Tests run the same
code and compare (tests/test_sandbox.py, tests/test_catalogue.py).
>>>>>>> 8be59d5 (Flask knows the everyday catalogue: names, pairs, history, plot, report; six pages for chemists)
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

<<<<<<< HEAD
PAGES = ("sandbox.md",)
"""Pages of this folder with such blocks."""
=======
HERE = Path(__file__).resolve().parent
PAGES = ("sandbox.md", *(f"chemist/{path.name}" for path in sorted((HERE / "chemist").glob("*.md"))))
"""Pages of this folder that have such blocks."""
>>>>>>> 8be59d5 (Flask knows the everyday catalogue: names, pairs, history, plot, report; six pages for chemists)
_BLOCKS = re.compile(r"(?P<code>```python\n(?P<source>(?:(?!```).)*)```\n\n```text\n)(?:(?!```).)*```", re.S)
_FILES = re.compile(r"```\w+\n# file: (?P<name>\S+)\n(?:(?!```).)*```", re.S)


def _run(source: str) -> str:
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(source, "<page>", "exec"), {"__name__": "__main__"})
    return said.getvalue()


<<<<<<< HEAD
def printed(page: str) -> str:
    """Return the text of a page with the current output of its code."""
    return _BLOCKS.sub(lambda found: f"{found['code']}{_run(found['source'])}```", page)
=======
def printed(page: str, images: Path | None = None) -> str:
    """The text of a page, with what its code prints now; pictures that it draws are copied to ``images``."""
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
>>>>>>> 8be59d5 (Flask knows the everyday catalogue: names, pairs, history, plot, report; six pages for chemists)


if __name__ == "__main__":
    for name in sys.argv[1:] or PAGES:
        path = HERE / name
        path.write_text(printed(path.read_text(encoding="utf-8"), HERE / "images"), encoding="utf-8")
