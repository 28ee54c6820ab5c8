"""Write the table of the recipes' results into docs/recipes.md: ``python docs/recipes.py``.

A result is made by ``python recipes/NAME.py --out recipes/results/NAME.json``; each recipe states the exact command.
"""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

from chemlab.config.display import markdown_table
from chemlab.config.files import replace_between

__all__ = ["PAGE", "RECIPES", "recipes", "table"]

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "recipes.md"
RECIPES = ROOT / "recipes"
_LAST = ("plain PPO", "scripted")


def recipes() -> list[Path]:
    """Return the recipes by name."""
    return sorted(path for path in RECIPES.glob("*.py") if path.stem != "recipe_parts")


def _paradigm(path: Path) -> str:
    """Return the first line of a recipe's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return text.partition("\n")[0].rstrip(".")


def _cell(outcome: dict[str, Any] | None) -> str:
    """Format the mean over seeds, the range if there are several seeds, and the cost if it is not 0."""
    if outcome is None:
        return ""
    spread = f" ({min(outcome['by_seed']):.3f} to {max(outcome['by_seed']):.3f})" if len(outcome["by_seed"]) > 1 else ""
    cost = f", cost {outcome['cost']:.4f}" if outcome["cost"] >= 5e-5 else ""
    return f"{outcome['mean']:.3f}{spread}{cost}"


def _steps(outcomes: dict[str, Any]) -> str:
    taken = sorted({one["steps"] for one in outcomes.values() if one["steps"]})
    return " to ".join(f"{steps:,}" for steps in dict.fromkeys((taken[0], taken[-1]))) if taken else "none"


def _rows(path: Path) -> list[str]:
    head = f"`{path.name}`: {_paradigm(path)}"
    kept = RECIPES / "results" / f"{path.stem}.json"
    if not kept.is_file():
        return [head, "", "not run yet", *[""] * 4]
    found = json.loads(kept.read_text(encoding="utf-8"))
    outcomes = found["outcomes"]
    first, *others = (f"{who} {_cell(one)}" for who, one in outcomes.items() if who not in _LAST)
    return [
        head,
        found["environment"],
        "; ".join([first, *others]),
        *(_cell(outcomes.get(who)) for who in _LAST),
        _gain(outcomes),
        f"{_steps(outcomes)}; {found['seeds']} x {found['episodes']}",
    ]


def _gain(outcomes: dict[str, Any]) -> str:
    """Return the gain of the paradigm, which comes first, over plain PPO: return, and cost if that changes."""
    if _LAST[0] not in outcomes:
        return ""
    own, plain = next(iter(outcomes.values())), outcomes[_LAST[0]]
    cost = own["cost"] - plain["cost"]
    return f"{own['mean'] - plain['mean']:+.3f}" + (f", cost {cost:+.3f}" if abs(cost) >= 5e-4 else "")


def table() -> list[str]:
    """Return the recipes' results as a Markdown table."""
    words, numbers = ("recipe", "where", "scored"), (*_LAST, "gained over PPO", "steps; seeds x episodes")
    return markdown_table({**dict.fromkeys(words, False), **dict.fromkeys(numbers, True)}, map(_rows, recipes()))


if __name__ == "__main__":
    replace_between(PAGE, "recipes", table())
