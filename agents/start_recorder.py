"""Record the vessels that reach each bench in laboratory episodes, as initial-state distribution for pretraining."""

from __future__ import annotations

from collections.abc import Callable

from chemlab.config.scenario import Scenario
from chemlab.envs.aec import raw_env
from chemlab.envs.players import Watching
from chemlab.lab.engine import Laboratories
from chemlab.lab.starts import SUBMIT, Start

from .episodes import play_episode
from .policies import make_policies, scripted_manager

_EXPLORE = 0.1
_LEAST_MOL = 1e-6


def _note(labs: Laboratories, action: int, found: dict[str, list[Start]]) -> None:
    """Store the vessel that a manager's action starts an experiment on, or submits."""
    kind, *arguments = labs.actions.decode(action)
    if kind == "start":
        stage = labs.benches[labs.bench_agents.index(str(arguments[0]))].key
        slot, goal = int(arguments[1]), str(arguments[2])
    elif kind == "submit":
        stage, slot = SUBMIT, int(arguments[0])
        goal = labs.scenario.goals[labs.state.goal[0, int(arguments[1]) if len(arguments) > 1 else 0]]
    else:
        return
    vessel, last = labs.shelf.vessel(0, slot), int(labs.state.last_bench[0, slot])
    contents = {n: mol for n, mol in vessel.amounts(_LEAST_MOL).items() if n in labs.shelf.layout.materials}
    bench = list(labs.scenario.benches)[last - 1] if last else None
    start = Start(goal, 1.0, vessel.capacity_l, contents, bench, int(labs.state.last_position[0, slot]))
    found[stage].append(start)


def record_starts(
    scenario: Scenario, episodes: int, seed: int, progress: Callable[[], None] | None = None
) -> dict[str, list[Start]]:
    """Play the scripted laboratory and store every vessel that is put on a bench or submitted.

    For variety, one in ten actions of the reaction bench is random, one episode in three skips extraction, and one in
    three does not decant metal.

    Args:
        scenario: the laboratory; every goal of its benches is played, including goals that are not laboratory goals.
        episodes: episodes for each goal.
        seed: first seed.
        progress: called after each episode.

    Returns:
        {bench key, or ``submit``: initial states}.
    """
    every_goal = scenario.model_copy(
        update={
            "lab_goals": scenario.goals,
            "theoretical_maximum_mol": {g: scenario.theoretical_maximum_mol.get(g, 1.0) for g in scenario.goals},
        }
    )
    env = raw_env(every_goal)
    labs, manager = env.laboratories, env.laboratories.manager.name
    found: dict[str, list[Start]] = {key: [] for key in (*scenario.benches, SUBMIT)}
    washing = {key for key, bench in scenario.benches.items() if bench.kind == "extraction"}
    ways = [scripted_manager(labs), scripted_manager(labs, skip=washing), scripted_manager(labs, careful=False)]
    if set(scenario.benches) == washing:
        ways = ways[::2]
    reacting = [key for key, bench in scenario.benches.items() if bench.kind == "reaction"]
    lapses = "".join(f",{key}=scripted@{_EXPLORE}" for key in reacting)
    for g, goal in enumerate(scenario.goals):
        for episode in range(episodes):
            number = seed + g * episodes + episode
            policies = make_policies(f"scripted{lapses}", labs)
            policies[manager] = Watching(ways[episode % len(ways)], lambda *call: _note(labs, int(call[-1][0]), found))
            play_episode(env, policies, number, options={"goal": goal})
            if progress is not None:
                progress()
    return found
