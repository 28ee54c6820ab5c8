"""Shipped bench policies where they were trained and where they are used: single benches and the laboratory.

:func:`collect_benches` plays, and stores means in ``benches.json`` beside the runs; :func:`benches_table` makes the
table from that file alone.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from chemlab.files import write_text
from chemlab.scenario import load_scenario

from ..pretrained import PretrainedPolicy, load_pretrained, pretrained_names
from ..roles import MANAGER_ROLE, role_of
from ..runs import RESULT_SEED, to_text, versions
from .laboratory import EPISODES
from .play import BenchTarget, LaboratoryTarget
from .statistics import number_text

__all__ = ["bench_policies", "benches_table", "collect_benches"]

_FILE = "benches.json"
_STARTS = ("paper", "lab")
_SCRIPTED = "heuristic"


def bench_policies() -> list[PretrainedPolicy]:
    """The policies that come with chemlab, but managers."""
    policies = [load_pretrained(name) for name in pretrained_names()]
    return [policy for policy in policies if policy.card.bench != MANAGER_ROLE]


def collect_benches(
    folder: Path, episodes: int = EPISODES, watch: Callable[[str], None] | None = None
) -> dict[str, Any]:
    """Play every shipped bench policy, and the scripted one, on its single bench and in its scenario's laboratory.

    In the laboratory all other roles are scripted, so that only the bench's policy differs. All play the same seeds,
    which neither training nor the choice of the checkpoint has seen.

    Args:
        folder: where the file goes.
        episodes: for each goal of the bench, and of the laboratory.
        watch: called with each policy's name when it has been played.

    Returns:
        ``{"policies": [...], ...}``: of each ``name``, ``scenario``, ``bench``, the ``starts`` it was trained on, and
        for ``trained`` and ``scripted`` the means over goals: return by starting state (``paper``, ``lab``), and in the
        laboratory the return of the bench's agents together (``reward``) and the manager's ``score``.
    """
    rows = []
    for policy in bench_policies():
        card = policy.card
        row: dict[str, Any] = {"name": card.name, "scenario": card.scenario, "bench": card.bench, "starts": card.starts}
        for column, name in (("trained", card.name), ("scripted", _SCRIPTED)):
            row[column] = _means(card.scenario, card.bench, name, episodes)
        rows.append(row)
        if watch is not None:
            watch(card.name)
    content = {
        "kind": "benches",
        "format": 1,
        "episodes_per_goal": episodes,
        "seed": RESULT_SEED,
        "versions": versions(),
        "policies": rows,
    }
    write_text(folder / _FILE, to_text(content))
    return content


def _means(scenario: str, bench: str, policy: str, episodes: int) -> dict[str, float]:
    loaded = load_scenario(scenario)
    means = {}
    for starts in _STARTS:
        target = BenchTarget(loaded, bench, starts)
        played = [target.play(policy, goal, episodes, RESULT_SEED) for goal in target.goals]
        means[starts] = sum(float(one.returns.mean()) for one in played) / len(played)
    laboratory = LaboratoryTarget(loaded)
    both = [laboratory.play(f"{_SCRIPTED},{bench}={policy}", goal, episodes, RESULT_SEED) for goal in laboratory.goals]
    prefix = "reward "
    rewards = [n for n in both[0].measures if n.startswith(prefix) and role_of(n.removeprefix(prefix)) == bench]
    means["reward"] = sum(float(one.measures[name].mean()) for one in both for name in rewards) / len(both)
    means["score"] = sum(float(one.returns.mean()) for one in both) / len(both)
    return means


def benches_table(folder: Path) -> list[str]:
    """The lines of a Markdown table of ``benches.json``.

    Raises:
        ValueError: the file is not there, or is not what was written.
    """
    file = folder / _FILE
    try:
        rows = json.loads(file.read_text(encoding="utf-8"))["policies"]
    except FileNotFoundError as error:
        raise ValueError(f"{folder}: has no {_FILE}; chemlab figures {folder} --collect makes it") from error
    except (ValueError, KeyError) as error:
        raise ValueError(f"{file}: not what chemlab figures --collect writes ({error})") from error
    lines = [
        "| policy | trained on | paper's starts | laboratory's starts | in the laboratory | laboratory's score |",
        "|---|---|--:|--:|--:|--:|",
    ]
    for row in rows:
        numbers = [
            f"{number_text(row['trained'][key])} ({number_text(row['scripted'][key])})"
            for key in (*_STARTS, "reward", "score")
        ]
        lines.append(f"| `{row['name']}` | {row['starts']} | {' | '.join(numbers)} |")
    return lines
