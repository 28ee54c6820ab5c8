"""Hierarchical learning: a manager over benches that know their work.

A manager's decision, to put a vessel on a bench and what for, is an option: it runs until the bench's agent has ended
the experiment (Sutton, Precup and Singh 1999, "Between MDPs and semi-MDPs"). The benches are scripted, or pretrained
(policies that come along), and PPO with masks learns the upper level from nothing. Beside it, no hierarchy: the same
learner for every role at once, all from nothing. Its steps are the turns of all roles, of which there are five to a
decision of the manager where benches know their work, so it has five times as many.

    python recipes/hierarchical.py --out recipes/results/hierarchical.json

Needs the extra ``train``.
"""

from __future__ import annotations

from typing import Any

from recipe_parts import AUDIT_SEED, ONCE, PLAIN, SCRIPTED, Budget, Outcome, cook, score_run

from chemlab.agents.evaluate.play import LaboratoryTarget
from chemlab.agents.train.arguments import JointArguments
from chemlab.agents.train.joint import train_together
from chemlab.config.scenario import load_scenario

TARGET = LaboratoryTarget(load_scenario("wurtz_dodecane_direct"))
GOAL = "dodecane"
TURNS = 5
"""Of all roles together to a decision of the manager: the scripted laboratory's 43 to 9."""


def learned_together(
    budget: Budget, roles: tuple[str, ...], steps: int, background: str = "scripted", **settings: Any
) -> Outcome:
    """What roles that learn from nothing come to, over others that are played by policies of that name."""
    size: dict[str, Any] = {"envs": 8, "rollout": 16} if budget.toy else {"envs": 64, "rollout": 64}
    size |= {"roles": roles, "background": background, "learning_rate": 1e-3}
    arguments = JointArguments(TARGET.scenario.name, seed=budget.seed, steps=steps, **{**size, **ONCE, **settings})
    return score_run(train_together, arguments, TARGET, GOAL, budget)


def recipe(budget: Budget) -> dict[str, Outcome]:
    """One seed of managers over both kinds of benches, of all roles at once, and the scripted laboratory."""
    everybody = ("manager", *TARGET.scenario.benches)
    return {
        "manager over scripted benches": learned_together(budget, ("manager",), budget.steps),
        "manager over pretrained benches": learned_together(budget, ("manager",), budget.steps, "pretrained"),
        PLAIN: learned_together(budget, everybody, TURNS * budget.steps),
        SCRIPTED: Outcome.of(TARGET.play("scripted", GOAL, budget.episodes, AUDIT_SEED)),
    }


if __name__ == "__main__":
    cook(recipe, __doc__, f"the laboratory of `{TARGET.scenario.name}`, {GOAL}", steps=40_000)
