"""How the code is put together: which modules import which, and how much kernels are handed."""

import ast
import functools
import importlib.metadata
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import pytest

import chemlab
import chemlab.agents
from chemlab.config.extras import needs

FOLDERS = {"chemlab": Path(chemlab.__path__[0]), "chemlab.agents": Path(chemlab.agents.__path__[0])}
COMPILED = {"kernel", "helper", "inner"}
MOST_PARAMETERS = 8


@functools.cache
def modules() -> dict[str, tuple[ast.Module, bool]]:
    """Every module by name: its code, and whether it is a package."""
    found = {}
    for package, folder in FOLDERS.items():
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            is_package = parts[-1] == "__init__"
            name = ".".join([package, *(parts[:-1] if is_package else parts)])
            found[name] = ast.parse(path.read_text(encoding="utf-8")), is_package
    return found


def running(body: list[Any]) -> Iterator[ast.stmt]:
    """All statements, in functions as well, but for what is for types alone."""
    for node in body:
        if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)):
            yield node
            for inner in ("body", "orelse", "finalbody", "handlers", "cases"):
                yield from running(getattr(node, inner, []))


def imports(name: str) -> set[str]:
    """Modules of ours that a module imports, when it is loaded or later."""
    code, is_package = modules()[name]
    wanted: list[str] = []
    for node in running(code.body):
        if isinstance(node, ast.Import):
            wanted += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            here = name.split(".") if is_package else name.split(".")[:-1]
            base = [*here[: len(here) + 1 - node.level], *([node.module] if node.module else [])]
            source = ".".join(base) if node.level else node.module or ""
            names = [f"{source}.{alias.name}" for alias in node.names]
            wanted += [one if one in modules() else source for one in names]
    return {one for one in wanted if one in modules()} - {name}


def test_no_module_imports_one_that_imports_it() -> None:
    """Nor by way of others; an import inside a function is one, too."""
    graph = {name: imports(name) for name in modules()}
    assert sum(map(len, graph.values())) > 500
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"a circle: {' <- '.join(error.args[1])}")


def test_no_module_is_named_like_another() -> None:
    """Only the backends of physics have one file per law under the same name, as the interface of backends has."""
    places: dict[str, list[str]] = {}
    for name, (_, is_package) in modules().items():
        if not is_package:
            place, _, own = name.rpartition(".")
            places.setdefault(own, []).append(place)
    backends = [f"chemlab.physics.backends.{backend}" for backend in ("paper", "real")]
    assert [own for own, found in places.items() if len(found) > 1 and sorted(found) != backends] == []


def test_no_test_file_is_named_like_another() -> None:
    """Their folders are no packages, so that pytest could collect only the first of two."""
    names = [path.name for path in Path(__file__).parent.rglob("test_*.py")]
    assert len(names) > 100
    assert sorted(names) == sorted(set(names))


def test_kernels_take_few_arguments() -> None:
    """What a kernel works with is one state and one set of parameters a layer, opened where it is needed."""
    kernels = [
        (f"{name}.{node.name}", len(node.args.posonlyargs) + len(node.args.args) + len(node.args.kwonlyargs))
        for name, (code, _) in modules().items()
        for node in ast.walk(code)
        if isinstance(node, ast.FunctionDef)
        and {ast.unparse(decorator).partition("(")[0] for decorator in node.decorator_list} & COMPILED
    ]
    assert len(kernels) > 100
    assert [kernel for kernel, count in kernels if count > MOST_PARAMETERS] == []


COMPILERS = ("numba", "llvmlite")
PUBLIC = {"numba", "numba.types", "numba.extending"}
PUBLIC |= {"numba.core.cgutils", "numba.core.event", "numba.core.typing.templates"}
"""Modules of numba that may be imported: its public interface, code generation for intrinsics, events for applications,
and base classes that ``numba.extending.infer_getattr`` and ``numba.core.event.register`` require."""


def test_nothing_else_of_numbas_insides_is_used() -> None:
    found, private, bases, numbas = set(), set(), set(), {path.split(".")[-1] for path in PUBLIC}
    for name, (code, _) in modules().items():
        for node in ast.walk(code):
            if isinstance(node, ast.Import):
                found |= {(name, alias.name) for alias in node.names if alias.name.partition(".")[0] in COMPILERS}
            elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in COMPILERS:
                paths = {f"{node.module}.{alias.name}" for alias in node.names}
                found |= {(name, path if path in PUBLIC else str(node.module)) for path in paths}
            elif name == "chemlab.kernels.jit" and isinstance(node, (ast.Attribute, ast.keyword, ast.Constant)):
                word = str(getattr(node, "attr", getattr(node, "arg", getattr(node, "value", None))))
                private |= {word} if word.startswith("_") and word.isidentifier() and not word.endswith("_") else set()
            elif isinstance(node, ast.ClassDef):
                bases |= {base.split(".")[-1] for base in map(ast.unparse, node.bases) if base.split(".")[0] in numbas}
    assert {(name, path) for name, path in found if path not in PUBLIC} == {("chemlab.record.recorder", "llvmlite")}
    assert {path for _, path in found} >= {"numba", "numba.extending"}
    assert bases == {"AttributeTemplate", "Listener"}
    # The value of a structure that code is generated for, as in numba's own guide to extensions, and an option.
    assert private == {"_getvalue", "_nrt"}


def test_what_is_missing_is_named_with_its_extra() -> None:
    extras = importlib.metadata.metadata("chemlab-marl").get_all("Provides-Extra") or []
    calls = [n for code, _ in modules().values() for n in ast.walk(code) if isinstance(n, ast.Call)]
    named = [ast.literal_eval(call.args[1]) for call in calls if getattr(call.func, "id", "") == "needs"]
    assert len(named) > 15
    assert set(named) <= set(extras)
    said = re.escape("figures need ink (No module named 'ink'): pip install \".[plot]\"")
    with pytest.raises(ImportError, match=said), needs("figures need ink", "plot"):
        importlib.import_module("ink")
