"""Registries are filled in either order of imports; nothing is imported unasked; a checkout works."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

import chemlab

HEAVY = ("gymnasium", "numba", "numpy", "pettingzoo", "pydantic", "torch")
AFTERWARDS = """
assert "chemlab/LabManager-v1" in gymnasium.registry and "chemlab/RealWurtzReaction-v0" in gymnasium.registry
assert gymnasium.spec("chemlab/WurtzReaction-v0").kwargs == {"scenario": "wurtz_dodecane", "bench": "rxn"}
try:
    from pettingzoo import aec_registry, parallel_registry
except ImportError:
    pass
else:
    assert "chemlab/Laboratory-v1" in aec_registry and "chemlab/Laboratory-v1" in parallel_registry
"""


def run(code: str) -> str:
    """What a fresh Python process that runs ``code`` prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("module", ["chemlab", "chemlab.cli"])
def test_what_plays_nothing_imports_nothing_heavy(module: str) -> None:
    assert run(f"import sys, {module}; print([name for name in {HEAVY} if name in sys.modules])") == "[]\n"


def test_scenarios_are_loaded_without_a_compiler() -> None:
    code = "import chemlab, sys; scenario = chemlab.load_scenario('unlabelled'); assert scenario.world.draws"
    assert run(f"{code}; print({{'numba', 'gymnasium', 'pettingzoo'}} & set(sys.modules))") == "set()\n"


def test_public_names_are_imported_when_they_are_used() -> None:
    assert dir(chemlab) == sorted(chemlab.__all__)
    for name, module in chemlab._MODULES.items():
        assert getattr(chemlab, name) is getattr(importlib.import_module(f"chemlab.{module}"), name)
    with pytest.raises(AttributeError, match="module 'chemlab' has no attribute 'reactor'"):
        chemlab.reactor  # noqa: B018


@pytest.mark.parametrize(
    "first",
    [
        "import chemlab, gymnasium, pettingzoo",
        "import gymnasium, pettingzoo, chemlab",
        "import pettingzoo, chemlab; import gymnasium",
        "import chemlab; from gymnasium.envs.registration import registry; import gymnasium",
        "import chemlab, importlib, gymnasium; importlib.reload(chemlab)",
        # Libraries that only look for others, as TorchRL does, import nothing.
        "import chemlab; from importlib.util import find_spec; find_spec('gymnasium'), find_spec('pettingzoo')\n"
        "import gymnasium, pettingzoo",
        # Imported twice, the second time with registries of its own.
        "import chemlab, sys, gymnasium; [sys.modules.pop(name) for name in [*sys.modules] if 'gymnasium' in name]\n"
        "import gymnasium",
    ],
)
def test_either_may_come_first(first: str) -> None:
    run(first + AFTERWARDS)


@pytest.mark.parametrize(
    "before",
    [
        "import chemlab; from importlib.util import find_spec; find_spec('gymnasium'); import gymnasium",
        "import gymnasium",  # as in a process that another one has spawned
    ],
)
def test_ids_that_name_the_module_need_nothing_else(before: str) -> None:
    run(f"{before}\ngymnasium.make('chemlab:chemlab/Bench-v1', scenario='fictitious', bench='rxn')")


def test_a_registered_library_keeps_its_own_loader() -> None:
    """Tools that read a library's source or files by its loader find what they find without chemlab."""
    show = "import gymnasium; print(type(gymnasium.__loader__).__name__, type(gymnasium.__spec__.loader).__name__)"
    assert run(f"import chemlab; {show}") == run(show)


ROOT = Path(__file__).parent.parent
CHECKOUT = pytest.mark.skipif(not (ROOT / "chemlab").is_dir(), reason="not a checkout")


def bare_python(*arguments: str) -> str:
    """What Python says that was started in the checkout, in which no installed chemlab can be found.

    ``-S`` leaves out what installations add to the import system; the dependencies come by their folders alone.
    """
    folders = [path for path in sys.path if path and (Path(path) / "numpy").is_dir()]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(folders)}
    command = [sys.executable, "-S", *arguments]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    return done.stdout


@CHECKOUT
def test_the_command_of_a_checkout_runs() -> None:
    assert "wurtz_dodecane" in bare_python("-m", "chemlab", "list")


@CHECKOUT
def test_environments_and_every_part_are_those_of_the_checkout() -> None:
    program = """
import gymnasium
import chemlab, chemlab.agents.policies, chemlab.scenarios
environment = gymnasium.make("chemlab/LabManager-v1", scenario="fictitious")
environment.reset(seed=0)
for module in (chemlab, chemlab.agents, chemlab.scenarios):
    print(module.__file__)
"""
    files = bare_python("-c", program).split()
    assert files == [str(ROOT / folder / "__init__.py") for folder in ("chemlab", "agents", "scenarios")]
