"""Bundled bench policies on the benches they were trained on and in the laboratory.

:func:`collect_benches` plays them and stores means in ``benches.csv``; :func:`benches_table` makes the table from this
file alone.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import chemlab
from chemlab import load_scenario
from chemlab.agents.evaluate.play import Target
from chemlab.agents.evaluate.statistics import number_text
from chemlab.agents.pretrained import PretrainedPolicy, load_pretrained, pretrained_names
from chemlab.agents.roles import MANAGER_ROLE, role_of
from chemlab.agents.runs import RESULT_SEED
from chemlab.config.display import markdown_table

from .managers import EPISODES
from .tables import number, read_table, write_table

_FILE, _STARTS, _SCRIPTED = "benches.csv", ("paper", "lab"), "scripted"
_COLUMNS = ("name", "scenario", "bench", "starts", "episodes", "seed", "chemlab", "player", *_STARTS, "reward", "score")


def bench_policies() -> list[PretrainedPolicy]:
    """Return the bundled bench policies."""
    policies = [load_pretrained(name) for name in pretrained_names()]
    return [policy for policy in policies if policy.card.bench != MANAGER_ROLE]


def collect_benches(folder: Path, episodes: int = EPISODES, watch: Callable[[str], None] | None = None) -> None:
    """Play every bundled bench policy, and the scripted one, on its single bench and in its scenario's laboratory.

    In the laboratory all other roles are scripted, so that only the bench's policy differs. All play the same seeds,
    which were used neither in training nor in the choice of the checkpoint.

    The table has two rows for each policy, of the ``trained`` and of the ``scripted`` player, with means over goals:
    return by starting state (``paper``, ``lab``), and in the laboratory the summed return of the bench's agents
    (``reward``) and the manager's ``score``.

    Args:
        folder: folder of the table.
        episodes: episodes per goal, on the bench and in the laboratory.
        watch: called with each policy's name when it has been played.
    """
    rows: list[dict[str, Any]] = []
    for policy in bench_policies():
        card = policy.card
        own: dict[str, Any] = {"name": card.name, "scenario": card.scenario, "bench": card.bench, "starts": card.starts}
        own |= {"episodes": episodes, "seed": RESULT_SEED, "chemlab": chemlab.__version__}
        for player, name in (("trained", card.name), ("scripted", _SCRIPTED)):
            means = _means(card.scenario, card.bench, name, episodes)
            rows.append({**own, "player": player, **{key: number(value) for key, value in means.items()}})
        if watch is not None:
            watch(card.name)
    write_table(folder / _FILE, _COLUMNS, rows)


def _means(scenario: str, bench: str, policy: str, episodes: int) -> dict[str, float]:
    loaded = load_scenario(scenario)
    means = {}
    for starts in _STARTS:
        target = Target(loaded, bench, starts)
        played = [target.play(policy, goal, episodes, RESULT_SEED) for goal in target.goals]
        means[starts] = sum(float(one.returns.mean()) for one in played) / len(played)
    laboratory = Target(loaded)
    both = [laboratory.play(f"{_SCRIPTED},{bench}={policy}", goal, episodes, RESULT_SEED) for goal in laboratory.goals]
    prefix = "reward "
    rewards = [n for n in both[0].measures if n.startswith(prefix) and role_of(n.removeprefix(prefix)) == bench]
    means["reward"] = sum(float(one.measures[name].mean()) for one in both for name in rewards) / len(both)
    means["score"] = sum(float(one.returns.mean()) for one in both) / len(both)
    return means


def benches_table(folder: Path) -> list[str]:
    """Return the lines of a Markdown table of ``benches.csv``.

    Raises:
        ValueError: the file does not exist or is malformed.
    """
    rows = read_table(folder / _FILE, _COLUMNS)
    if not rows:
        raise ValueError(f"{folder}: has no {_FILE}; python -m studies.paper --collect RUNS makes it")
    means = {(row["name"], row["player"]): row for row in rows}
    lines = []
    for row in rows[::2]:
        ours, theirs = means[row["name"], "trained"], means[row["name"], "scripted"]
        cells = [
            f"{number_text(float(ours[key]))} ({number_text(float(theirs[key]))})"
            for key in (*_STARTS, "reward", "score")
        ]
        lines.append([f"`{row['name']}`", row["starts"], *cells])
    names = ("paper's starts", "laboratory's starts", "in the laboratory", "laboratory's score")
    made: list[str] = markdown_table({"policy": False, "trained on": False, **dict.fromkeys(names, True)}, lines)
    return made
