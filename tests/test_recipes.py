"""Recipes run, and their page has the numbers that are kept of them."""

from __future__ import annotations

import importlib.util
import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
RECIPES = sorted(path for path in (ROOT / "recipes").glob("*.py") if path.stem != "recipe_parts")
NEEDS = {"bayesian": ("sklearn",), "planning": ()}
"""Packages that a recipe needs, where it is not what most need."""
LEARNING = ("stable_baselines3", "sb3_contrib")
pytestmark = pytest.mark.skipif(not RECIPES, reason="not a checkout")


@pytest.mark.slow
@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_recipes_run(path: Path, tmp_path: Path) -> None:
    """What is kept of a toy run is what it printed, finite, and of everybody it names."""
    for package in NEEDS.get(path.stem, LEARNING):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"needs {package}")
    out = tmp_path / "result.json"
    command = [sys.executable, str(path), "--toy", "--seeds", "2", "--out", str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    found = json.loads(out.read_text(encoding="utf-8"))
    assert found == json.loads(done.stdout)
    assert found["toy"]
    assert "scripted" in found["outcomes"]
    for outcome in found["outcomes"].values():
        assert len(outcome["by_seed"]) == 2
        assert all(math.isfinite(value) for value in (outcome["mean"], outcome["cost"], *outcome["by_seed"]))
        assert outcome["mean"] == pytest.approx(sum(outcome["by_seed"]) / 2, abs=1e-4)
    # The script knows nothing that a seed would change, and plays the same episodes.
    assert len(set(found["outcomes"]["scripted"]["by_seed"])) == 1


def test_the_page_has_the_kept_results(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    from recipes import PAGE, table

    assert "\n".join(table()) in PAGE.read_text(encoding="utf-8"), "run: python docs/recipes.py"


@pytest.mark.parametrize("path", sorted((ROOT / "recipes" / "results").glob("*.json")), ids=lambda path: path.stem)
def test_kept_results_are_no_toys(path: Path) -> None:
    """And say the command that makes them, which names this file."""
    found = json.loads(path.read_text(encoding="utf-8"))
    assert not found["toy"]
    assert found["command"].startswith(f"python recipes/{path.stem}.py ")
    assert f"recipes/results/{path.name}" in found["command"]
