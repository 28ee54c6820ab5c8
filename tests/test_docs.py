"""The documentation tells the truth: its code runs, its data files load, its pages build, its tables are complete."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer

from chemlab.cli import app
from chemlab.materials import load_materials, read_toml
from chemlab.reactions import ReactionFamily
from chemlab.scenario import load_scenario, scenario_names

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [path for path in sorted(DOCS.rglob("*.md")) if not {"generated", "_build"} & set(path.parts)]
COMMAND: Any = typer.main.get_command(app)
OPTIONAL = ("stable_baselines3", "sb3_contrib", "torch", "torchrl", "ray", "PIL", "matplotlib", "pygame", "minari")
NEEDS = {
    "train": "stable_baselines3",
    "train-rllib": "ray",
    "export": "stable_baselines3",
    "figures": "matplotlib",
    "plot": "matplotlib",
}
"""What a command needs beyond the core."""

pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="not a checkout")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: Path
    line: int
    language: str
    text: str

    @property
    def file(self) -> str | None:
        """The file it is to be written to."""
        found = re.match(r"# file: (\S+)\n", self.text)
        return found[1] if found else None

    @property
    def where(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    def commands(self) -> Iterator[list[str]]:
        """The words of its ``chemlab`` commands."""
        for line in self.text.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words and words[0] == "chemlab":
                yield words[1:]
            elif words and self.language == "bash":
                raise AssertionError(f"{self.where}: bash blocks are chemlab commands, found {line!r}")


def blocks_of(page: Path) -> list[Block]:
    """Every fenced block that has a language."""
    text = page.read_text(encoding="utf-8")
    found = re.finditer(r"^```(\w+)\n(.*?)^```$", text, re.S | re.M)
    return [Block(page, text[: m.start()].count("\n") + 1, m[1], m[2]) for m in found]


def lacking(block: Block) -> list[str]:
    """Optional packages that a block needs and that are not here."""
    needed = {name for name in OPTIONAL if re.search(rf"^(from|import) {name}\b", block.text, re.M)}
    if block.language == "bash":
        needed |= {NEEDS[words[0]] for words in block.commands() if words[0] in NEEDS}
        # The files that training would have made are not there either.
        needed |= {"stable_baselines3"} if re.search(r"runs/trial|--policy trial", block.text) else set()
    return sorted(name for name in needed if importlib.util.find_spec(name) is None)


def parse(words: list[str], where: str) -> None:
    """A command that exists, with options that exist."""
    command, rest = COMMAND, list(words)
    context: Any = None
    while hasattr(command, "commands"):
        context = typer.Context(command, parent=context, info_name=where)
        command = command.commands[rest.pop(0)]
    command.make_context(words[0], rest, parent=context)


def check_data(block: Block, folder: Path) -> None:
    """A TOML block as what it is: a scenario, a material, a reaction family, or a part that parses."""
    path = folder / (block.file or "block.toml")
    path.write_text(block.text, encoding="utf-8")
    content = read_toml(path)
    if "lab_goals" in content:
        load_scenario(path)
    elif "reaction" in content:
        ReactionFamily.model_validate(content)
    elif any("molar_mass_g_mol" in table for table in content.values() if isinstance(table, dict)):
        assert load_materials([path])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty working folder, whose modules can be imported; modules of the page do not outlive it."""
    known = set(sys.modules)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    if importlib.util.find_spec("torch") is not None:
        import torch

        # Networks this small are slower on several threads.
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        yield tmp_path
        torch.set_num_threads(threads)
    else:
        yield tmp_path
    for name in set(sys.modules) - known:
        if (getattr(sys.modules[name], "__file__", None) or "").startswith(str(tmp_path)):
            del sys.modules[name]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS).with_suffix("")))
def test_code_runs(page: Path, folder: Path) -> None:
    """A page's blocks one after the other in one folder, each in a namespace of its own."""
    left_out = []
    for block in blocks_of(page):
        if missing := lacking(block):
            left_out.append(f"{block.where} needs {', '.join(missing)}")
            continue
        if block.language == "python":
            if re.search(r"make(_vec)?\(\s*[\"'](aec|parallel|chemlab)", block.text):
                assert re.search(r"^(import chemlab|from chemlab)", block.text, re.M), f"{block.where}: import chemlab"
            if block.file:
                (folder / block.file).write_text(block.text, encoding="utf-8")
            code = compile("\n" * block.line + block.text, str(page), "exec")
            with contextlib.redirect_stdout(io.StringIO()):
                exec(code, {"__name__": "__main__"})
        elif block.language == "bash":
            for words in block.commands():
                run(words, block.where)
        elif block.language == "console":
            for words in block.commands():
                parse(words, block.where)
        elif block.language == "toml":
            check_data(block, folder)
        else:
            assert block.language in ("text",), f"{block.where}: what is {block.language}?"
    if left_out:
        print("left out:", *left_out, sep="\n")


def run(words: list[str], where: str) -> None:
    """A command in this process; it must not end with an error."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = COMMAND.main(args=words, prog_name="chemlab", standalone_mode=False)
    assert code in (None, 0), f"{where}: chemlab {shlex.join(words)} ended with {code}: {said.getvalue()}"


def test_console_commands_are_checked() -> None:
    """A command or an option that does not exist is found."""
    parse(["run", "fictitious", "--episodes", "3"], "here")
    with pytest.raises(KeyError):
        parse(["fly", "fictitious"], "here")
    with pytest.raises(Exception, match="--altitude"):
        parse(["run", "fictitious", "--altitude", "3"], "here")


def test_links_between_pages_and_pictures_exist() -> None:
    """Relative links of the pages and of README lead somewhere; those into generated pages are Sphinx's to check."""
    for page in [*PAGES, ROOT / "README.md"]:
        text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)
        for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", text):
            if "://" not in target and "generated/" not in target:
                assert (page.parent / target).exists(), f"{page.relative_to(ROOT)}: {target}"


def test_pictures_are_small() -> None:
    """What everybody downloads with the repository."""
    images = DOCS / "images"
    assert (images / "laboratory.png").stat().st_size < 60_000
    assert (images / "episode.webp").stat().st_size < 400_000


def test_pages_build_without_warnings(tmp_path: Path) -> None:
    """Every scenario, command and environment has its page, and the tables are those of the spaces."""
    for package in ("sphinx", "myst_parser", "furo"):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f'building the documentation needs {package}: pip install "chemlab-marl[docs]"')
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", str(DOCS), str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    pages = tmp_path / "generated"
    for name in scenario_names():
        assert load_scenario(name).title in (pages / "scenarios" / f"{name}.html").read_text(encoding="utf-8")
    commands = (pages / "command.html").read_text(encoding="utf-8")
    for name in COMMAND.commands:
        assert f"chemlab {name}" in commands
    for name in ("laboratory", "parallel", "focal", "benches", "batched"):
        assert (pages / "environments" / f"{name}.html").exists()
    check_tables((DOCS / "generated" / "environments" / "benches.md").read_text(encoding="utf-8"))


def check_tables(page: str) -> None:
    """The indices of an observation's table run from 0 to its size without a gap, and so do the actions'."""
    row = re.compile(r"^\| (\d+)(?: to (\d+))? \|", re.M)
    tables = re.findall(r"### (?:Observation|Actions) of `\w+`: (?:Box|Discrete)\((\d+)\)\n(.*?)(?=\n#|\Z)", page, re.S)
    assert len(tables) >= 10
    for size, table in tables:
        at = 0
        for first, last in row.findall(table):
            assert int(first) == at
            at = int(last or first) + 1
        assert at == int(size)
