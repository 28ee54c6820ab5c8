"""Multi-agent learning: every role at once, with separate or centralized critics.

Manager, reaction bench and distillation bench of `wurtz_dodecane_direct` learn together; half of each reward is the
agent's own and half the laboratory's result. All start as clones of the scripted agents, because learners from scratch
fail (see `hierarchical.py`). Independent learners (IPPO, de Witt et al. 2020, "Is Independent Learning All You Need in
the StarCraft Multi-Agent Challenge?") have critics of their own observations. The critics of MAPPO (Yu et al. 2022,
"The Surprising Effectiveness of PPO in Cooperative Multi-Agent Games") also observe the true state in training. The
comparison is a single learner: the manager, cloned alike, over scripted benches. Steps are turns of the learning
agents; demonstrations do not count.

    python recipes/multi_agent.py --steps 30000 --out recipes/results/multi_agent.json

Needs the extra ``train``.
"""

from __future__ import annotations

from typing import Any

from recipe_parts import AUDIT_SEED, ONCE, PLAIN, SCRIPTED, Budget, Outcome, cook, score_run

from chemlab import load_scenario
from chemlab.agents.evaluate.play import Target
from chemlab.agents.train.arguments import IPPO, MAPPO

TARGET = Target(load_scenario("wurtz_dodecane_direct"))
GOAL = "dodecane"
LEARNING: dict[str, Any] = {
    "rewards": "mixed",
    "bc": "scripted",
    "bc_steps": 4000,
    "bc_rounds": 2,
    "learning_rate": 1e-4,
}


def team(budget: Budget, algorithm: type[IPPO] = IPPO, **settings: Any) -> Outcome:
    """Train a team, and score it."""
    given: dict[str, Any] = {**LEARNING, "envs": 64, "rollout": 32, "batch_size": 512}
    if budget.toy:  # without demonstrations
        given = {"rewards": "mixed", "envs": 4, "rollout": 12}
    given = {**given, **ONCE, **settings}
    arguments = algorithm(scenario=TARGET.scenario.name, seed=budget.seed, steps=budget.steps, **given)
    return score_run(arguments, TARGET, GOAL, budget)


def recipe(budget: Budget) -> dict[str, Outcome]:
    """Train one seed of both teams and of the manager alone; score the scripted laboratory."""
    return {
        "IPPO": team(budget),
        "MAPPO": team(budget, MAPPO),
        PLAIN: team(budget, roles=("manager",)),
        SCRIPTED: Outcome.of(TARGET.play("scripted", GOAL, budget.episodes, AUDIT_SEED)),
    }


if __name__ == "__main__":
    cook(recipe, __doc__, f"the laboratory of `{TARGET.scenario.name}`, {GOAL}", steps=100_000)
