"""Write the output of a page's code into the page: ``python docs/printed.py [PAGE ...]``.

``python docs/printed.py --times`` measures the time to the first plot of the guided pages for the table of
``sandbox.md``.

A ``text`` block right after a ``python`` block is the output of that block. Figures that it saves are copied to
``images``. A test runs the same code and compares (tests/test_docs.py).
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

__all__ = ["PAGES", "printed"]

HERE = Path(__file__).resolve().parent
PAGES = ("sandbox.md", *(f"chemist/{path.name}" for path in sorted((HERE / "chemist").glob("*.md"))))
"""Pages of this folder with such blocks."""
_BLOCKS = re.compile(r"(```python\n(?P<source>(?:(?!```).)*)```\n)(?P<text>\n```text\n(?:(?!```).)*```)?", re.S)
_FILES = re.compile(r"```\w+\n# file: (?P<name>\S+)\n(?:(?!```).)*```", re.S)


def _run(source: str) -> str:
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(source, "<page>", "exec"), {"__name__": "__main__"})
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")  # a block is a program of its own: the next one begins with an empty figure
    return said.getvalue()


def _with_output(block: re.Match[str]) -> str:
    said = _run(block["source"])
    return f"{block[1]}\n```text\n{said}```" if block["text"] else block[1]


@contextlib.contextmanager
def _folder(page: str) -> Iterator[Path]:
    """A temporary working directory with the files of a page."""
    before = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for block in _FILES.finditer(page):
                Path(block["name"]).write_text(block[0].partition("\n")[2].removesuffix("```"), encoding="utf-8")
            yield Path(folder)
        finally:
            os.chdir(before)


def printed(page: str, images: Path | None = None) -> str:
    """Return the text of a page with the current output of its code; copy the figures that it saves to ``images``."""
    with _folder(page) as folder:
        text = _BLOCKS.sub(_with_output, page)
        for picture in folder.glob("*.png") if images else ():
            if f"images/{picture.name}" in page:
                shutil.copy(picture, images or "")
    return text


def _first_plot(page: str) -> float:
    """Return s of CPU time that a page's code takes until it has saved a figure."""
    begun = time.process_time()
    with _folder(page) as folder:
        for block in _BLOCKS.finditer(page):
            _run(block["source"])
            if any(folder.glob("*.png")):
                break
    return time.process_time() - begun


def times() -> list[str]:
    """Return the table of times to the first plot: with kernels compiled, in a new process, and once more in it."""
    from chemlab.config.display import markdown_table

    rows = []
    for name in PAGES[1:]:
        command = [sys.executable, __file__, "--first-plot", name]
        # The first process compiles kernels if they are not in the cache.
        _, said = (subprocess.run(command, check=True, capture_output=True, text=True).stdout for _ in range(2))
        title = (HERE / name).read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
        rows.append([title, *said.split()])
    return markdown_table({"page": False, "computing (s)": True, "again (s)": True}, rows)


def main(arguments: list[str]) -> None:
    """Write the output of pages, or measure."""
    if arguments[:1] == ["--first-plot"]:
        page = (HERE / arguments[1]).read_text(encoding="utf-8")
        _first_plot(page)
        print(f"{time.process_time():.1f} {_first_plot(page):.1f}")
        return
    if arguments == ["--times"]:
        from chemlab.config.files import replace_between

        replace_between(HERE / "sandbox.md", "times", times())
        return
    for name in arguments or PAGES:
        path = HERE / name
        path.write_text(printed(path.read_text(encoding="utf-8"), HERE / "images"), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
