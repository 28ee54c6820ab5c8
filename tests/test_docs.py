"""The documentation tells the truth: its code runs, its data files load, its pages build, its tables are complete."""

import contextlib
import importlib
import importlib.util
import io
import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import typer
from helpers import script, slow_but

from chemlab import __version__
from chemlab.agents.episodes import play_laboratory
from chemlab.agents.policies import make_policies
from chemlab.cli import app
from chemlab.cli.options import DefaultGroup
from chemlab.config.datafile import read_toml
from chemlab.config.inherit import campaign_names, scenario_names, synthesis_names
from chemlab.config.loading import load_scenario
from chemlab.config.materials import load_materials
from chemlab.config.reactions import ReactionFamily
from chemlab.lab.engine import Laboratories

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [path for path in sorted(DOCS.rglob("*.md")) if not {"generated", "_build"} & set(path.parts)]
COMMAND: Any = typer.main.get_command(app)
pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="not a checkout")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: Path
    line: int
    language: str
    text: str
    shown: bool = False
    """Whether it is what the bash block right above it says, or some lines of that."""

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
    found = [(text[: m.start()], *m.groups()) for m in re.finditer(r"^```(\w+)\n(.*?)^```$", text, re.S | re.M)]
    return [Block(page, over.count("\n") + 1, kind, own, kind == "text" and follows(over)) for over, kind, own in found]


def follows(text: str) -> bool:
    """Whether a text ends with a bash block."""
    return re.search(r"^```bash\n(?:(?!```).*\n)*```\n+\Z", text, re.M) is not None


def lacking(error: BaseException) -> str:
    """The package that is not installed, if that is why something failed."""
    while error.__cause__ is not None:
        error = error.__cause__
    name = error.name if isinstance(error, ModuleNotFoundError) else None
    return name if name is not None and importlib.util.find_spec(name.partition(".")[0]) is None else ""


def makes(block: Block) -> list[str]:
    """Files and folders that a block's commands are told to write."""
    words = [word for command in block.commands() for word in command] if block.language == "bash" else []
    return [path for option, path in pairwise(words) if option in ("-o", "--out", "--record")]


def uses(block: Block, path: str) -> bool:
    """Whether a block's commands name a path, one in it or below it, or one that begins like it (NAME.json)."""
    if block.language != "bash":
        return False
    words = [word for command in block.commands() for given in command for word in re.split("[=,]", given)]
    near = (f"{path}/", f"{path}.")
    return any(word == path or word.startswith(near) or path.startswith(f"{word}/") for word in words)


def parse(words: list[str], where: str) -> None:
    """A command that exists, with options that exist."""
    command, rest = COMMAND, list(words)
    context: Any = None
    while hasattr(command, "commands"):
        context = typer.Context(command, parent=context, info_name=where)
        known = command.commands
        if isinstance(command, DefaultGroup) and rest[0] not in known:
            command = next(iter(known.values()))
        else:
            command = known[rest.pop(0)]
    command.make_context(words[0], rest, parent=context)


def check_data(block: Block, folder: Path) -> None:
    """Check a TOML block: a scenario is played, a material or reaction family validated, a part parsed."""
    path = folder / (block.file or "block.toml")
    path.write_text(block.text, encoding="utf-8")
    content = read_toml(path)
    if "lab_goals" in content or "base" in content:
        labs = Laboratories(load_scenario(path))
        play_laboratory(labs, make_policies("scripted", labs), None, 0)
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
    yield tmp_path
    for name in set(sys.modules) - known:
        if (getattr(sys.modules[name], "__file__", None) or "").startswith(str(tmp_path)):
            del sys.modules[name]


LONG = DOCS / "how-to" / "physics-tier.md"  # compiles a tier of its own
EXACT = [page for page in PAGES if page.name == "sandbox.md" or page.parent.name == "chemist"]
PLAYED = slow_but([page for page in PAGES if page not in EXACT], *(page for page in PAGES if page != LONG))


@pytest.mark.parametrize("page", PLAYED, ids=lambda page: str(page.relative_to(DOCS).with_suffix("")))
def test_code_runs(page: Path, folder: Path) -> None:
    """A page's blocks one after the other in one folder, each in a namespace of its own."""
    left_out: list[str] = []
    not_made: list[str] = []
    said = ""
    for block in blocks_of(page):
        missing = next((f"{path}, which was not made" for path in not_made if uses(block, path)), "")
        try:
            if block.shown:
                assert not said or not (unsaid := not_said(block.text, said)), f"{block.where}: not said: {unsaid}"
            elif not missing:
                said = check(block, page, folder)
        except ImportError as error:
            missing = lacking(error)
            if not missing:
                raise
        if missing:
            said = ""
            left_out.append(f"{block.where} needs {missing}")
            not_made += makes(block)
    if left_out:
        pytest.skip(f"everything else runs; {'; '.join(left_out)}")


@pytest.mark.parametrize("page", EXACT, ids=lambda page: page.stem)
def test_pages_show_exactly_what_their_code_prints(page: Path) -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("Agg")
    made = script("docs/printed.py")
    assert [DOCS / name for name in made.PAGES] == sorted(EXACT, key=lambda one: one.name != "sandbox.md")
    text = page.read_text(encoding="utf-8")
    assert made.printed(text) == text, f"run: python docs/printed.py {page.relative_to(DOCS)}"
    assert not pyplot.get_fignums(), "the next page would draw over these figures"
    if page.name != "sandbox.md":
        assert (DOCS / "images" / f"{page.stem}.png").stat().st_size < 120_000


def not_said(shown: str, said: str) -> str:
    """The first line of a page that was not printed; numbers may be 5 % off, as with other versions of packages."""
    lines = [line for line in shown.splitlines() if line.strip()]
    return next((line for line in lines if not any(same(line, told) for told in said.splitlines())), "")


def same(one: str, other: str) -> bool:
    """Whether two lines have the same words and about the same numbers."""
    parts = [re.split(r"(-?\d+(?:\.\d+)?)", " ".join(line.split())) for line in (one, other)]
    if len(parts[0]) != len(parts[1]) or parts[0][::2] != parts[1][::2]:
        return False
    return [float(x) for x in parts[0][1::2]] == pytest.approx([float(x) for x in parts[1][1::2]], rel=0.05, abs=2e-3)


def check(block: Block, page: Path, folder: Path) -> str:
    """Do with a block what is to be done with its kind.

    Returns:
        What its commands said.

    Raises:
        ImportError: it needs what is not installed.
    """
    if block.language == "python":
        if re.search(r"make(_vec)?\(\s*[\"'](aec|parallel|chemlab)", block.text):
            assert re.search(r"^(import chemlab|from chemlab)", block.text, re.M), f"{block.where}: import chemlab"
        if block.file:
            (folder / block.file).write_text(block.text, encoding="utf-8")
        code = compile("\n" * block.line + block.text, str(page), "exec")
        with contextlib.redirect_stdout(io.StringIO()):
            exec(code, {"__name__": "__main__"})
    elif block.language == "bash":
        return "\n".join([run(words, block.where) for words in block.commands()])
    elif block.language == "console":
        for words in block.commands():
            parse(words, block.where)
    elif block.language == "toml":
        check_data(block, folder)
    else:
        assert block.language in ("text", "bibtex"), f"{block.where}: what is {block.language}?"
    return ""


def run(words: list[str], where: str) -> str:
    """What a command in this process says; it must not end with an error."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = COMMAND.main(args=["--traceback", *words], prog_name="chemlab", standalone_mode=False)
    assert code in (None, 0), f"{where}: chemlab {shlex.join(words)} ended with {code}: {said.getvalue()}"
    return said.getvalue()


def test_the_checks_of_pages_see_what_is_wrong() -> None:
    """A command or an option that does not exist is found, and what was not made is not asked for."""
    parse(["run", "fictitious", "--episodes", "3"], "here")
    with pytest.raises(KeyError):
        parse(["fly", "fictitious"], "here")
    with pytest.raises(Exception, match="--altitude"):
        parse(["run", "fictitious", "--altitude", "3"], "here")
    trial = "runs/trial"
    assert makes(Block(DOCS, 1, "bash", f"chemlab train manager --out {trial} --quiet\n")) == [trial]
    for words in (f"evaluate fictitious --policy scripted,manager={trial}", "plot runs runs", f"export {trial}/b.zip"):
        assert uses(Block(DOCS, 9, "bash", f"chemlab {words}\n"), trial)
    assert not uses(Block(DOCS, 9, "bash", "chemlab run fictitious --policy runs/trials\n"), trial)


PROSE = [*PAGES, *sorted(ROOT.glob("*.md"))]


def prose(page: Path) -> str:
    """A page without its blocks."""
    return re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)


def anchors(page: Path) -> set[str]:
    """What links may name on a page: its headings as GitHub and MyST call them."""
    headings = re.findall(r"^#+ (.*)$", prose(page), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_lead_somewhere() -> None:
    """Every relative link works in a checkout; pages that Sphinx makes are named by roles, which Sphinx checks."""
    checked = 0
    for page in PROSE:
        for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)]*))?\)", prose(page)):
            if "://" in target:
                continue
            checked += 1
            file = page.parent / target if target else page
            assert file.exists(), f"{page}: {target} does not exist"
            made = f"{page}: {target} is not in a checkout; write {{doc}}`words <{target.removesuffix('.md')}>`"
            assert "generated" not in file.parts, made
            assert not anchor or anchor in anchors(file), f"{page}: {target}#{anchor}: has {sorted(anchors(file))}"
    assert checked > 200


def test_the_map_names_every_module_of_the_physics() -> None:
    """Whether what it names is there is checked in tests/test_map.py."""
    stems = {Path(name).stem for name in re.findall(r"`([\w./*]+\.py)`", (DOCS / "map.md").read_text(encoding="utf-8"))}
    modules = {path.stem for path in (ROOT / "chemlab" / "physics").glob("*.py")}
    assert {"__init__", "constants", "events"} < modules
    assert modules - stems <= {"__init__", "constants", "events"}


def test_pictures_are_small_and_the_citation_names_this_version() -> None:
    """Pictures are what everybody downloads with the repository."""
    assert (DOCS / "images" / "episode.webp").stat().st_size < 400_000
    gallery = {path.stem: path.stat().st_size for path in (DOCS / "_static" / "scenarios").glob("*")}
    assert set(gallery) <= {*scenario_names(), *campaign_names(), *synthesis_names()}
    assert sum(gallery.values()) < 5_000_000
    assert f"{{{__version__}}}" in (DOCS / "about.md").read_text(encoding="utf-8")


WIDE = {
    "how-to/language-agent.md": 1,
    "performance.md": 2,
    "protocol.md": 1,
    "results.md": 3,
    "results/laboratory.md": 9,
    "results/scripted.md": 1,
    "results/summary.md": 2,
    "syntheses.md": 1,
    "training.md": 1,
}
"""Tables of more than seven columns, which commands of ``studies/`` make from runs; there must not be more."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_tables_are_narrow_and_say_what_a_score_is(page: Path) -> None:
    """A table has at most seven columns; a page with a table of scores links their definition."""
    text = page.read_text(encoding="utf-8")
    heads = re.findall(r"^\|(.*)\|\n\|[\s:|-]+\|$", text, re.M)
    assert sum(head.count("|") > 6 for head in heads) == WIDE.get(page.relative_to(DOCS).as_posix(), 0)
    if any(re.search(r"\b(score|scored|scripted)\b", head) for head in heads):
        assert "#what-a-score-means" in text or page.name == "glossary.md"


def test_the_table_of_times_is_that_of_the_stored_runs() -> None:
    """And a score is reached at the first of two evaluations in a row."""
    pytest.importorskip("stable_baselines3", reason="needs the extra train")
    made = script("studies/baselines/time_to_score.py")
    runs = json.loads(made.SCORES.read_text(encoding="utf-8"))
    assert "\n".join(made.table(runs)) in (DOCS / "training.md").read_text(encoding="utf-8"), made.__doc__
    asked = {scenario: round(made.asked(scenario), 4) for scenario in made.STEPS}
    for run in runs:
        assert run["target"] == asked[run["scenario"]]
        watch = made.Watch(run["target"], run["cap"], 0.0, lambda sampled: 0.0)
        points = (point.split(":") for point in run["evaluations"].split())
        watch.points = [(float(seconds), 0, float(score)) for seconds, score in points]
        assert (watch.reached() or (None,))[0] == run["seconds"]


def test_pages_and_code_are_in_plain_words() -> None:
    """None has a word that ``studies/tools/words.py`` refuses; no docstring begins with a question word."""
    words = script("studies/tools/words.py")
    checked = words.code()
    assert len(checked) > 80
    assert [line for path in (ROOT / "README.md", *PAGES, *checked) for line in words.findings(path)] == []


def test_notebooks_run_what_their_pages_run(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("sphinx", reason="needs the extra docs")
    monkeypatch.syspath_prepend(str(DOCS))
    from generate import NOTEBOOKS, notebook

    for name in NOTEBOOKS:
        cells = json.loads(notebook((DOCS / name).read_text(encoding="utf-8")))["cells"]
        blocks = [block.text for block in blocks_of(DOCS / name) if block.language in ("python", "bash")]
        shown = [text.rstrip().replace("\\\n    ", "") for text in blocks]
        found = [c["source"] for c in cells if c["cell_type"] == "code"]
        assert [source.replace("!chemlab ", "chemlab ") for source in found] == shown
        assert not any(re.search(r"^(chemlab |%%bash)", source, re.M) for source in found)


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_commands_are_valid_shell() -> None:
    """Bash itself reads every command of README and the pages; ``shlex`` accepts what bash refuses."""
    for page in PROSE:
        for block in blocks_of(page):
            if block.language in ("bash", "console"):
                done = subprocess.run(["bash", "-n"], input=block.text, capture_output=True, text=True)
                assert done.returncode == 0, f"{block.where}: {done.stderr}"


def unknown_options(command: Any, words: list[str]) -> list[str]:
    """The options of a command's words that it does not have; its first word if that is no command."""
    while hasattr(command, "commands") and words and words[0] in command.commands:
        command, words = command.commands[words[0]], words[1:]
    if isinstance(command, DefaultGroup):
        command = next(iter(command.commands.values()))
    params = command.get_params(typer.Context(command))
    known = {option for one in params for option in (*one.opts, *one.secondary_opts)}
    options = [word for word in words if re.match("--[a-z]", word) and word.partition("=")[0] not in known]
    return words[:1] if command is COMMAND and words and words[0].isalpha() else options


@pytest.mark.skipif(not (ROOT / ".ci").is_dir(), reason="needs a checkout")
def test_commands_in_sentences_comments_and_errors_exist() -> None:
    """With their options; blocks of pages are checked above."""
    assert unknown_options(COMMAND, ["fly", "--altitude"]) == ["fly"]
    assert unknown_options(COMMAND, ["audit", "rush", "--turns", "0", "--altitude=3"]) == ["--altitude=3"]
    folders = ("chemlab", "agents", "studies", "recipes", "docs")
    scripts = [path for name in folders for end in ("py", "toml", "sh") for path in (ROOT / name).rglob(f"*.{end}")]
    checked = 0
    for path in (*(page for page in PROSE if page.name != "CHANGELOG.md"), *scripts):
        text = path.read_text(encoding="utf-8").replace("\\\n", " ")
        quoted = re.findall(r"`(chemlab [a-z][^`]*)`", text)
        lines = re.findall(r"^[# ]*(chemlab (?:train|export|sweep|plot|run|evaluate|audit|data) .*)", text, re.M)
        for command in (*quoted, *lines):
            assert not (lacking := unknown_options(COMMAND, command.split()[1:])), f"{path}: {command}: {lacking}"
            checked += 1
    assert checked > 200


@pytest.mark.skipif(not (ROOT / ".ci").is_dir(), reason="needs a checkout")
def test_files_that_are_named_exist() -> None:
    """In what decides whether a change lands, and in every page; the changelog also tells of files that were moved."""
    for place in [ROOT / ".ci" / "run", *(page for page in PROSE if page.name != "CHANGELOG.md")]:
        named = set(re.findall(r"\b(?:tests|studies|recipes)/[\w/]+\.\w+", place.read_text(encoding="utf-8")))
        missing = sorted(name for name in named if not (ROOT / name).exists())
        assert not missing, f"{place.relative_to(ROOT)} names files that do not exist: {missing}"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built pages; Sphinx's warnings are errors."""
    for package in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(package, reason="needs the extra docs")
    folder = tmp_path_factory.mktemp("pages")
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", str(DOCS), str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_no_text_leaves_its_cell(built: Path, visitor: Any) -> None:
    """On a desktop and a telephone no text overlaps or is cut; pages neither complain nor ask a host."""
    # Pages of the interface are alike: two of them.
    shown = sorted(file for file in built.rglob("*.html") if file.parent.name != "api")
    shown += sorted((built / "generated" / "api").glob("*.html"))[:2]
    outside, page = {}, visitor(shown[0].as_uri(), built.as_uri())
    for file in shown:
        page.goto(file.as_uri())
        for width in (1280, 390):
            page.set_viewport_size({"width": width, "height": 900})
            found = page.evaluate(
                """() => [...document.querySelectorAll("td, th, article button, label, a.scenario, h1, h2, h3")]
                .filter(part => {
                    const text = document.createRange(), box = part.getBoundingClientRect();
                    text.selectNodeContents(part);
                    const scrolls = part.closest(".table-wrapper, pre, .sidebar-drawer, .toc-drawer");
                    const cut = box.width && !scrolls && box.right > innerWidth + 1;
                    return cut || text.getBoundingClientRect().right > box.right + 2;
                }).map(part => part.textContent.trim().slice(0, 60))"""
            )
            if found:
                outside[f"{file.relative_to(built)} at {width} px"] = found
            if page.evaluate("document.documentElement.scrollWidth > innerWidth + 1"):
                outside[f"{file.relative_to(built)} at {width} px"] = "the page scrolls sideways"
    assert not outside


@pytest.mark.slow
def test_pages_build_without_warnings(built: Path) -> None:
    """Every scenario, command and environment has its page, and the tables are those of the spaces."""
    pages = built / "generated"
    for name in scenario_names():
        assert load_scenario(name).title in (pages / "scenarios" / f"{name}.html").read_text(encoding="utf-8")
    # The words before a colon are not taken for an attribute's type: annotations alone give types.
    api = [file.read_text(encoding="utf-8") for file in (pages / "api").glob("*.html")]
    assert ["chemlab" in page and 'Type<span class="colon">' not in page for page in api] == [True] * max(len(api), 9)
    commands = (pages / "command.html").read_text(encoding="utf-8")
    for name in COMMAND.commands:
        assert f"chemlab {name}" in commands
    for name in ("laboratory", "parallel", "role", "batched"):
        assert (pages / "environments" / f"{name}.html").exists()
    check_tables((DOCS / "generated" / "environments" / "role.md").read_text(encoding="utf-8"))
    keys = (DOCS / "generated" / "keys.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\]\(#(\w+)\)", keys)) <= {model.lower() for model in re.findall(r"^### (\w+)$", keys, re.M)}
    home = (built / "index.html").read_text(encoding="utf-8")
    features = (DOCS / "generated" / "scenarios" / "index.md").read_text(encoding="utf-8")
    for name in scenario_names():
        assert home.count(f"<strong>{name}</strong>") == 1
        row = next(line for line in features.splitlines() if line.startswith(f"| [`{name}`]"))
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        scenario = load_scenario(name)
        assert len(cells) == 7
        assert (cells[2], cells[3] == "nothing") == (scenario.physics, not scenario.world.draws)
    assert "normalized score" in (pages / "leaderboard.html").read_text(encoding="utf-8").lower()


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
