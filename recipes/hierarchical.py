"""Hierarchical learning: a manager over competent benches.

A manager's decision, which vessel to put on a bench for which goal, is an option: it runs until the bench's agent ends
the experiment (Sutton, Precup and Singh 1999, "Between MDPs and semi-MDPs"). The benches are scripted or pretrained
(bundled policies), and PPO with masks learns the upper level from scratch. The comparison has no hierarchy: the same
learner for every role at once, all from scratch. Its steps are turns of all roles. With competent benches there are
five of them per decision of the manager, so it has five times as many.

    python recipes/hierarchical.py --out recipes/results/hierarchical.json

Needs the extra ``train``.
"""

from __future__ import annotations

from typing import Any

from recipe_parts import AUDIT_SEED, ONCE, PLAIN, SCRIPTED, Budget, Outcome, cook, score_run

from chemlab import load_scenario
from chemlab.agents.evaluate.play import Target
from chemlab.agents.train.arguments import IPPO

TARGET = Target(load_scenario("wurtz_dodecane_direct"))
GOAL = "dodecane"
TURNS = 5
"""Turns of all roles per decision of the manager: 43 to 9 in the scripted laboratory."""


def learned_together(
    budget: Budget, roles: tuple[str, ...], steps: int, background: str = "scripted", **settings: Any
) -> Outcome:
    """Train roles from scratch, with the other roles played by named policies, and score them."""
    size: dict[str, Any] = {"envs": 8, "rollout": 16} if budget.toy else {"envs": 64, "rollout": 64}
    size |= {"roles": roles, "background": background, "learning_rate": 1e-3}
    arguments = IPPO(scenario=TARGET.scenario.name, seed=budget.seed, steps=steps, **{**size, **ONCE, **settings})
    return score_run(arguments, TARGET, GOAL, budget)


def recipe(budget: Budget) -> dict[str, Outcome]:
    """Train one seed of managers over both kinds of benches and of all roles at once; score the scripted laboratory."""
    everybody = ("manager", *TARGET.scenario.benches)
    return {
        "manager over scripted benches": learned_together(budget, ("manager",), budget.steps),
        "manager over pretrained benches": learned_together(budget, ("manager",), budget.steps, "pretrained"),
        PLAIN: learned_together(budget, everybody, TURNS * budget.steps, practice=0.0),
        SCRIPTED: Outcome.of(TARGET.play("scripted", GOAL, budget.episodes, AUDIT_SEED)),
    }


if __name__ == "__main__":
    cook(recipe, __doc__, f"the laboratory of `{TARGET.scenario.name}`, {GOAL}", steps=40_000)
