"""The map of the source: every path and every name on it exists, and the walks are short."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "docs" / "map.md").read_text(encoding="utf-8")
OTHER = {"chemlab", "chemlab.agents", "chem", "real", "config.json", "[instruments]", "state()", "chemlab check"}
"""Commands, extras and values on the page, which are neither paths nor names of the source."""


def tokens() -> Iterator[tuple[str, str]]:
    """Each word of code on the page outside of command lines, with the folder of the path before it in its line."""
    for line in TEXT.splitlines():
        folder = ""
        for token in re.findall(r"`([^`]+)`", line):
            if not (token in OTHER or token.startswith("chemlab train")):
                yield token, folder
            if "/" in token:
                folder = token.rpartition("/")[0]


@cache
def names() -> set[str]:
    """Every function, class, method, field and constant of the source, methods and fields also as ``Class.name``."""
    found: set[str] = set()

    def collect(body: list[ast.stmt], owner: str) -> None:
        for node in body:
            own: list[str] = []
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                own = [node.name]
            elif isinstance(node, ast.Assign):
                own = [target.id for target in node.targets if isinstance(target, ast.Name)]
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                own = [node.target.id]
            found.update(own, (f"{owner}.{name}" for name in own if owner))
            if isinstance(node, ast.ClassDef):
                collect(node.body, node.name)

    for folder in ("chemlab", "agents"):
        for path in (ROOT / folder).rglob("*.py"):
            collect(ast.parse(path.read_text(encoding="utf-8")).body, "")
    return found


def is_there(path: str, folder: str) -> bool:
    """Return True if a path of the page exists: from the root, ``chemlab/``, or the folder before it."""
    return any(any(base.glob(path)) for base in (ROOT, ROOT / "chemlab", ROOT / folder, ROOT / "chemlab" / folder))


@pytest.mark.parametrize(("token", "folder"), sorted(set(tokens())))
def test_what_the_map_names_exists(token: str, folder: str) -> None:
    if "/" in token or re.search(r"\.(py|md|toml)$", token):
        assert is_there(token.rstrip("/"), folder)
    else:
        assert token in names()


def test_a_name_beside_its_file_is_defined_in_it() -> None:
    """``file.py`` followed by a name, in the table of rules: the name is in that file."""
    pairs = re.findall(r"`([\w/]+\.py)`, `(?!\w+\.py)(?:\w+\.)?(\w+)`", TEXT)
    assert len(pairs) > 10
    for path, name in pairs:
        (file,) = {found for folder in ("chemlab", "agents") for found in (ROOT / folder).rglob(path.split("/")[-1])}
        assert re.search(rf"(def|class) {name}\b", file.read_text(encoding="utf-8")), f"{path}: {name}"


def test_walks_have_few_stops() -> None:
    walks = re.split(r"^## The path of ", TEXT, flags=re.M)[1:]
    assert len(walks) == 2
    for walk in walks:
        stops = re.findall(r"^(?:\| )?(\d+)(?:\.| \|)", walk.partition("\n## ")[0], flags=re.M)
        assert [int(stop) for stop in stops] == list(range(1, len(stops) + 1))
        assert 3 < len(stops) <= 8
