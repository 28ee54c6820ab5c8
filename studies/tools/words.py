"""Check the prose of the project against its style: ``python studies/tools/words.py [FILE ...]``.

Reads README, the pages below docs, every docstring, and the strings of the commands (help and messages). Refuses the
words in ``REFUSED`` and docstrings that begin with a question word. Prints ``file:line: text`` for each finding, and
exits with 1 if there is one.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
REFUSED = (
    r"whoever|whomever|nobody|strangers?|go(?:es)? astray|(?:comes?|came|coming) along|those (?:that|who)|"
    r"(?:is|are) told|as much as it|no number that is|(?:what is|that is) not meant|worth of|what comes"
)
_REFUSED = re.compile(rf"\b(?:{REFUSED})\b", re.IGNORECASE)
_QUESTION = re.compile(r"(?:What|Who|Whose|Whoever|Whether|Which|Where|How|When)\b(?! to\b)")
CODE = ("chemlab", "agents", "recipes", "studies", "docs")
EXCEPTIONS: dict[str, str] = {}
"""Accepted texts, each with its reason."""


def _pages() -> list[Path]:
    pages = [path for path in (ROOT / "docs").rglob("*.md") if not {"generated", "_build"} & set(path.parts)]
    return [ROOT / "README.md", *sorted(pages)]


def _prose(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines of a page outside code."""
    fenced = False
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if line.startswith("```"):
            fenced = not fenced
        elif not fenced:
            yield number, re.sub(r"`[^`]*`", "", line)


def _docstrings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and text of every docstring, including those below assignments."""
    for node in ast.walk(tree):
        body = getattr(node, "body", ())
        for child in body if isinstance(body, list) else ():
            value = child.value if isinstance(child, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield child.lineno, value.value


def _strings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


def findings(path: Path) -> list[str]:
    """Return the findings in one file, as ``file:line: text``."""
    name, found = path.resolve().relative_to(ROOT).as_posix(), []
    if path.suffix == ".md":
        texts = list(_prose(path))
    else:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        texts = list(_docstrings(tree))
        found += [
            f"{name}:{line}: begins with a question word: {text.splitlines()[0]}"
            for line, text in texts
            if _QUESTION.match(text) and text.splitlines()[0] not in EXCEPTIONS
        ]
        if "cli" in path.parts:
            texts = list(_strings(tree))
    for line, text in texts:
        refused = _REFUSED.search(text)
        if refused and not any(known in text for known in EXCEPTIONS):
            found.append(f"{name}:{line}: {refused[0]!r} in: {' '.join(text.split())[:100]}")
    return found


def code() -> list[Path]:
    """Return all source files."""
    return [path for folder in CODE for path in sorted((ROOT / folder).rglob("*.py")) if "_build" not in path.parts]


def main() -> None:
    """Check the given files, or all of them."""
    paths = [Path(name) for name in sys.argv[1:]] or [*_pages(), *code()]
    found = [line for path in paths for line in findings(path)]
    print("\n".join(found) or f"{len(paths)} files: nothing found")
    raise SystemExit(1 if found else 0)


if __name__ == "__main__":
    main()
