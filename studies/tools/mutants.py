"""Check that the tests detect faults: ``python studies/tools/mutants.py TEST ... --results FILE``.

Makes single-line mutants of physics, roles and laboratories: another operator, comparison or number, or a negated
condition. Runs the given tests on each mutant in a temporary copy of the working tree; a mutant is killed if a test
fails, or if the tests take ten times as long as without it. Results are appended to FILE: a second run with the same
arguments continues. ``--tests-of COMMIT`` takes the tests of another commit, to compare two test suites on the same
mutants. Kernels are compiled for every mutant, which takes about a minute: give the tests of one part at a time.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("chemlab/physics", "chemlab/roles", "chemlab/lab")
_LEAST_S = 60.0
"""Minimum time limit of a mutant."""
_OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}


@dataclass(frozen=True)
class Mutant:
    """A change of one line.

    Attributes:
        path: file, relative to the repository.
        line: line number.
        before, after: the line without and with the change.
    """

    path: str
    line: int
    before: str
    after: str

    def apply(self, root: Path) -> None:
        """Change the line in a copy of the repository."""
        lines = (root / self.path).read_text(encoding="utf-8").splitlines(keepends=True)
        assert lines[self.line - 1] == self.before + "\n", f"{self.path}:{self.line} is not what the mutant was made of"
        lines[self.line - 1] = self.after + "\n"
        (root / self.path).write_text("".join(lines), encoding="utf-8")

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.before.strip()}  ->  {self.after.strip()}"


def _changed(node: ast.AST) -> ast.expr | None:
    """Return a mutated copy of an expression, or None if there is no mutation of its kind."""
    if isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in _OPERATORS:
        other = _OPERATORS[type(node.op)]()
        return (
            ast.BinOp(node.left, other, node.right) if isinstance(node, ast.BinOp) else ast.BoolOp(other, node.values)
        )
    if isinstance(node, ast.Compare):
        first, *others = node.ops
        return ast.Compare(node.left, [_OPERATORS[type(first)](), *others], node.comparators)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return node.operand
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        return ast.Constant(not node.value)
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        value = node.value
        return ast.Constant(value + 1 if isinstance(value, int) else 1.5 * value if value else 0.5)
    return None


def _expressions(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the expressions of function bodies and of module constants, without annotations and defaults."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.arguments | ast.Import | ast.ImportFrom | ast.Assert | ast.Raise | ast.JoinedStr):
            continue
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AnnAssign):
            children = node.body if not isinstance(node, ast.AnnAssign) else [node.value] if node.value else []
            yield from _expressions(ast.Module(children, []))
            continue
        yield node
        yield from _expressions(node)


def mutants(path: Path, root: Path = ROOT) -> list[Mutant]:
    """Return all mutants of a file, in the order of its lines."""
    text = path.read_text(encoding="utf-8")
    lines, found = text.splitlines(), set[Mutant]()
    for node in _expressions(ast.parse(text)):
        other = _changed(node)
        if other is None or node.lineno != node.end_lineno or node.end_col_offset is None:
            continue
        line = lines[node.lineno - 1]
        coded = line.encode()
        start, stop = node.col_offset, node.end_col_offset
        written = f"({ast.unparse(other)})" if not isinstance(other, ast.Constant) else ast.unparse(other)
        after = (coded[:start] + written.encode() + coded[stop:]).decode()
        found.add(Mutant(path.relative_to(root).as_posix(), node.lineno, line, after))
    return sorted(found, key=lambda mutant: (mutant.line, mutant.after))


def choose(count: int, seed: int, folders: Sequence[str] = FOLDERS, root: Path = ROOT) -> list[Mutant]:
    """Return random mutants of the files in some folders, at most one of each line."""
    files = sorted(path for folder in folders for path in (root / folder).rglob("*.py"))
    by_line: dict[tuple[str, int], list[Mutant]] = {}
    for mutant in (mutant for path in files for mutant in mutants(path, root)):
        by_line.setdefault((mutant.path, mutant.line), []).append(mutant)
    rng = random.Random(seed)
    places = rng.sample(sorted(by_line), min(count, len(by_line)))
    return [rng.choice(by_line[place]) for place in places]


def _copy(to: Path, tests_of: str | None) -> None:
    """Copy the files of the working tree that git knows, with the tests of another commit if asked for."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True).stdout
    for name in names.decode().split("\0"):
        if name and (ROOT / name).is_file():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, to / name)
    if tests_of:
        shutil.rmtree(to / "tests")
        packed = subprocess.run(["git", "archive", tests_of, "tests"], cwd=ROOT, check=True, capture_output=True).stdout
        subprocess.run(["tar", "-x", "-C", str(to)], input=packed, check=True)


def _run(command: Sequence[str], copy: Path, limit_s: float | None) -> tuple[int | None, float, str]:
    """Run the tests in a copy; return the exit code (None: timed out), the seconds, and the last lines of output."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as kernels:  # those of a mutant serve nothing else
        environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
        environment["NUMBA_CACHE_DIR"] = kernels
        try:
            done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=limit_s)
        except subprocess.TimeoutExpired:
            return None, time.monotonic() - began, "timed out"
    return done.returncode, time.monotonic() - began, done.stdout[-2000:]


def _known(path: Path) -> dict[str, dict[str, object]]:
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    return {str(result["mutant"]): result for result in map(json.loads, lines)}


def _judged(arguments: argparse.Namespace, copy: Path) -> dict[str, dict[str, object]]:
    """Run the tests on every mutant without a result; return all results by mutant."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    command += [*arguments.tests, *shlex.split(arguments.options)]
    chosen, results = choose(arguments.mutants, arguments.seed, arguments.folders), _known(arguments.results)
    waiting = [mutant for mutant in chosen if str(mutant) not in results]
    if waiting:
        code, seconds, output = _run(command, copy, None)
        if code != 0:
            raise SystemExit(f"the tests do not pass without a mutant (exit code {code}):\n{output}")
        print(f"without a mutant: {seconds:.0f} s", file=sys.stderr)
    for mutant in waiting:
        source = (copy / mutant.path).read_text(encoding="utf-8")
        mutant.apply(copy)
        code, seconds_here, _ = _run(command, copy, max(10.0 * seconds, _LEAST_S))
        (copy / mutant.path).write_text(source, encoding="utf-8")
        result = {"mutant": str(mutant), "killed": code != 0, "exit_code": code, "seconds": round(seconds_here, 1)}
        results[str(mutant)] = result | asdict(mutant)
        with arguments.results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(results[str(mutant)]) + "\n")
        print(f"{'killed' if code else 'survived' if code == 0 else 'timed out'}  {mutant}", file=sys.stderr)
    return {str(mutant): results[str(mutant)] for mutant in chosen}


def main(given: Sequence[str] | None = None) -> int:
    """Run the command; return 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tests", nargs="+", help="tests, as pytest takes them")
    parser.add_argument("--results", type=Path, required=True, help="file of results, one JSON object per line")
    parser.add_argument("--mutants", type=int, default=200, help="number of mutants")
    parser.add_argument("--seed", type=int, default=0, help="seed of the choice of mutants")
    parser.add_argument("--folders", nargs="+", default=FOLDERS, help="folders whose files are changed")
    parser.add_argument("--tests-of", help="commit whose tests are run; default: those of the working tree")
    parser.add_argument("--options", default="", help="further options of pytest")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args(given)
    with tempfile.TemporaryDirectory() as place:
        _copy(Path(place), arguments.tests_of)
        results = _judged(arguments, Path(place))
    survived = [name for name, result in results.items() if not result["killed"]]
    summary = {"mutants": len(results), "killed": len(results) - len(survived), "survived": survived}
    if arguments.json:
        print(json.dumps(summary, indent=1))
    else:
        print(f"{summary['killed']} of {len(results)} mutants killed; survived:", *survived or ["none"], sep="\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
