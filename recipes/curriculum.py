"""Curriculum: a manager that learns the last step of a workflow first.

A random manager rarely finishes a workflow. The preset `manager-curriculum` of ``chemlab train`` starts with a finished
vessel, or one on its way to the last bench, then moves one bench back at a time, and ends with the scenario's own shelf
(a reverse curriculum). The comparison is the same learner (MaskablePPO, same settings, same steps) on the whole
workflow. The benches are scripted in both, so this is also the upper level of a hierarchy.

    python recipes/curriculum.py --seeds 3 --out recipes/results/curriculum.json

Needs the extra ``train``.
"""

from __future__ import annotations

from typing import Any

from recipe_parts import AUDIT_SEED, ONCE, PLAIN, SCRIPTED, Budget, Outcome, cook, score_run

from chemlab import load_scenario
from chemlab.agents.evaluate.play import Target
from chemlab.agents.train.arguments import training_arguments

TARGET = Target(load_scenario("wurtz_dodecane_direct"))
GOAL = "dodecane"


def manager(budget: Budget, staged: bool) -> Outcome:
    """Train a manager with ``chemlab train --roles manager`` and score its last checkpoint."""
    size: dict[str, Any] = {"envs": 8, "rollout": 16} if budget.toy else {}
    given = {"roles": "manager", "preset": "manager-curriculum", "scenario": TARGET.scenario.name, "seed": budget.seed}
    arguments = training_arguments({**given, "steps": budget.steps, **ONCE, **size})
    if not staged:
        arguments = arguments.model_copy(update={"curriculum": None})
    return score_run(arguments, TARGET, GOAL, budget)


def recipe(budget: Budget) -> dict[str, Outcome]:
    """Train one seed of both managers, and score the scripted one."""
    return {
        "curriculum": manager(budget, staged=True),
        PLAIN: manager(budget, staged=False),
        SCRIPTED: Outcome.of(TARGET.play("scripted", GOAL, budget.episodes, AUDIT_SEED)),
    }


if __name__ == "__main__":
    cook(recipe, __doc__, f"the manager of `{TARGET.scenario.name}`, {GOAL}", steps=200_000)
