"""Curriculum: a manager that learns the last step of a workflow first.

A random manager rarely finishes a workflow. The preset `manager-curriculum` of ``chemlab train`` begins with a finished
vessel, or one on its way to the last bench, then to the one before, at last with the scenario's own shelf. Beside it,
the same learner (MaskablePPO, same settings, same steps) that begins with the whole workflow at once. The benches are
scripted in all of them, so this is the upper level of a hierarchy as well.

    python recipes/curriculum.py --out recipes/results/curriculum.json

Needs the extra ``train``.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from recipe_parts import AUDIT_SEED, PLAIN, SCRIPTED, Budget, Outcome, cook

from chemlab.agents.evaluation.play import LaboratoryTarget
from chemlab.agents.runs import Run
from chemlab.agents.training.arguments import TrainArguments
from chemlab.agents.training.learn import train
from chemlab.scenario import load_scenario

TARGET = LaboratoryTarget(load_scenario("wurtz_dodecane_direct"))
GOAL = "dodecane"
ONCE = {"evaluations": 1, "checkpoints": 1, "eval_episodes": 2, "final_episodes": 2}


def manager(budget: Budget, staged: bool) -> Outcome:
    """What a run of ``chemlab train manager`` comes to with its last checkpoint."""
    size: dict[str, Any] = {"envs": 8, "rollout": 16} if budget.toy else {"envs": 64}
    given = {"env_id": "manager", "preset": "manager-curriculum", "scenario": TARGET.scenario.name, "seed": budget.seed}
    arguments = TrainArguments.of({**given, "steps": budget.steps, **ONCE, **size})
    if not staged:
        arguments = replace(arguments, curriculum=())
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        train(arguments, run)
        played = TARGET.play(str(Run(run).checkpoint("last")), GOAL, budget.episodes, AUDIT_SEED)
    return Outcome.of(played, arguments.steps)


def recipe(budget: Budget) -> dict[str, Outcome]:
    """One seed of both managers, and the scripted one."""
    return {
        "curriculum": manager(budget, staged=True),
        PLAIN: manager(budget, staged=False),
        SCRIPTED: Outcome.of(TARGET.play("heuristic", GOAL, budget.episodes, AUDIT_SEED)),
    }


if __name__ == "__main__":
    cook(recipe, __doc__, f"the manager of `{TARGET.scenario.name}`, {GOAL}", steps=100_000)
