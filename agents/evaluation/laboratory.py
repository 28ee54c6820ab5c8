"""What managers have learned: their runs' best checkpoints beside scripted ones, as a table and as learning curves.

:func:`collect_laboratories` plays, and stores means of episodes in ``laboratory.json`` beside the runs;
:func:`write_laboratory` makes the page from that file and from the runs' own files alone.

Runs belong together if they have one scenario, one background (who plays the roles that did not learn) and one folder
(a table of a sweep, say, with a folder for each seed), whose name is their label.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.files import write_text
from chemlab.laboratory.core import Laboratories
from chemlab.render.figure import SETTINGS, import_matplotlib, save_figure
from chemlab.scenario import load_scenario, scenario_names

from ..player import Played
from ..policies import make_policies
from ..pretrained import fingerprint
from ..roles import MANAGER_ROLE
from ..runs import RESULT_SEED, to_text, versions
from ..saved import find_saved
from . import statistics
from .curves import Tasks, draw_tasks
from .play import LaboratoryTarget
from .results import FinishedRun, display_name, read_results
from .statistics import interval_text, number_text

__all__ = [
    "BASELINES",
    "EPISODES",
    "MEASURES",
    "LaboratoryPage",
    "brief_table",
    "collect_laboratories",
    "laboratory_count",
    "write_laboratory",
]

EPISODES = 200
"""For each goal."""

MEASURES: tuple[str, ...] = (
    "score",
    "safety_cost",
    "submitted_mol",
    "purity",
    "instruments",
    "ticks",
    "manager_actions",
)
"""Means that are stored: the score and what measuring has cost in units of the score, the weighted safety events (the
constrained-RL cost), mol of all orders together, purity in [0, 1] (0 where nothing was submitted), and two counts."""

BASELINES: dict[str, tuple[str, str]] = {
    "scripted": ("heuristic", "scripted"),
    "direct": ("direct", "scripted, without extraction"),
    "hasty": ("hasty", "fixed plan, nothing measured"),
    "random": ("random", "random legal actions"),
}
"""Managers that learned nothing: their policy's name (the benches are the background's) and what the table says."""

_FILE, _PAGE, _CURVES = "laboratory.json", "laboratory.md", "laboratory_curves"

Means = dict[str, dict[str, float]]
"""By goal and measure."""


@dataclass
class _Group:
    """Runs of one scenario with one background, by label."""

    scenario: str
    background: str
    runs: dict[str, list[FinishedRun]] = field(default_factory=dict)


@dataclass(frozen=True)
class LaboratoryPage:
    """What was written.

    Attributes:
        page: the table's file.
        left_out: runs whose checkpoints were not played, and why.
    """

    page: Path
    left_out: list[str]


def _groups(folder: Path) -> list[_Group]:
    """The finished runs of managers below a folder, in order of scenario, background and label."""
    groups: dict[tuple[str, str], dict[Path, list[FinishedRun]]] = {}
    for one in read_results(folder).laboratories:
        key = str(one.config["scenario"]), str(one.config.get("background") or "heuristic")
        groups.setdefault(key, {}).setdefault(one.run.path.parent, []).append(one)
    found = []
    for (scenario, background), parents in sorted(groups.items()):
        names = [_name(parent) for parent in parents]
        labels = {
            # Two trainers may have folders of one name.
            parent: _name(parent) if names.count(_name(parent)) == 1 else parent.relative_to(folder).as_posix()
            for parent in parents
        }
        ordered = sorted(parents.items(), key=lambda item: labels[item[0]])
        runs = {labels[parent]: sorted(some, key=lambda one: one.result.seed) for parent, some in ordered}
        found.append(_Group(scenario, background, runs))
    return found


def _name(parent: Path) -> str:
    return parent.resolve().name


def _stored(folder: Path) -> dict[str, Any] | None:
    """The content of ``laboratory.json``, or None.

    Raises:
        ValueError: it is not JSON.
    """
    file = folder / _FILE
    try:
        content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise ValueError(f"{file}: not valid JSON: {error}") from error
    return content


# -- playing ----------------------------------------------------------------------------------------------------------


def laboratory_count(folder: Path) -> int:
    """Number of policies that :func:`collect_laboratories` will play, or leave out.

    Raises:
        ValueError: the folder is not there, or a file in it is not what a run writes.
    """
    return sum(len(BASELINES) + sum(map(len, group.runs.values())) for group in _groups(folder))


def collect_laboratories(
    folder: Path, episodes: int = EPISODES, watch: Callable[[str], None] | None = None
) -> dict[str, Any] | None:
    """Play every run's best checkpoint and the managers that learned nothing; write ``laboratory.json``.

    All play the same seeds, which neither training nor the choice of the checkpoint has seen. A run is compared with
    the scripted manager over its own benches: where benches have learned with the manager, those play there as well.

    Args:
        folder: the results; the file stands in it.
        episodes: for each goal.
        watch: called with each policy's name when it has been played or left out.

    Returns:
        ``{"groups": [...], "left_out": [{"run", "reason", "kept"}], ...}``, or None (and no file) where there are no
        such runs. A group has ``scenario``, ``background``, ``goals``, ``baselines`` {name: {goal: {measure: mean}}},
        and ``runs`` with ``label``, ``run`` (path below the folder), ``seed``, ``steps``, ``seconds``, ``learned``
        (roles), ``by_goal`` and ``scripted`` {goal: {measure: mean}}. A run that cannot be played any more keeps what
        the file had of it; a group without any run that can stays as it was.

    Raises:
        ValueError: the folder is not there, or a file in it is not what a run writes.
        ImportError: a run was trained with Stable-Baselines3, which is not installed.
    """
    groups = _groups(folder)
    if not groups:
        return None
    told = watch or (lambda _: None)
    before = {(g["scenario"], g["background"]): g for g in (_stored(folder) or {}).get("groups", [])}
    played, left_out = [], []
    for group in groups:
        found, lacking = _played(folder, group, before.get((group.scenario, group.background)), episodes, told)
        played += [found] if found["runs"] else []
        left_out += lacking
    content = {"kind": "laboratory", "format": 1, **_circumstances(episodes), "groups": played, "left_out": left_out}
    write_text(folder / _FILE, to_text(content))
    return content


def _circumstances(episodes: int) -> dict[str, Any]:
    return {"episodes_per_goal": episodes, "seed": RESULT_SEED, "versions": versions()}


def _played(
    folder: Path, group: _Group, before: dict[str, Any] | None, episodes: int, told: Callable[[str], None]
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """A group's part of the file, and its runs that were left out."""
    kept = {run["run"]: run for run in (before or {}).get("runs", [])}
    reasons = {one.run.path: _obstacle(group, one) for runs in group.runs.values() for one in runs}
    playable = any(reason is None for reason in reasons.values())
    found: dict[str, Any] = {"scenario": group.scenario, "background": group.background, "goals": []}
    found |= {name: (before or {}).get(name, {}) for name in ("baselines", *_circumstances(episodes))}
    found["goals"] = (before or {}).get("goals", [])
    target = None
    if playable:
        target = LaboratoryTarget(load_scenario(group.scenario))
        found |= {"goals": list(target.goals), **_circumstances(episodes)}
        found["baselines"] = {}
    for name, (policy, _) in BASELINES.items():
        if target is not None:
            found["baselines"][name] = _means(target, f"{group.background},{MANAGER_ROLE}={policy}", episodes)
        told(f"{group.scenario}: {name}")
    found["runs"], left_out = [], []
    for label, runs in group.runs.items():
        for one in runs:
            name, reason = one.run.path.relative_to(folder).as_posix(), reasons[one.run.path]
            if target is not None and reason is None:
                found["runs"].append({"label": label, "run": name, **_run(target, one, found["baselines"], episodes)})
            elif name in kept:
                found["runs"].append({**kept[name], "label": label})
            if reason is not None:
                left_out.append({"run": name, "reason": reason, "kept": name in kept})
            told(f"{group.scenario}: {name}")
    return found, left_out


def _obstacle(group: _Group, one: FinishedRun) -> str | None:
    """Why a run cannot be played, or None."""
    path = one.run.path
    if one.run.checkpoint("best") is None and one.run.checkpoint("last") is None:
        return f"its checkpoints are missing ({one.run.checkpoints})"
    try:
        if MANAGER_ROLE not in find_saved(str(path)).load:
            return f"its checkpoint has no manager ({one.run.checkpoints})"
        make_policies(str(path), Laboratories(load_scenario(group.scenario)))
    except ValueError as error:  # the scenario or a policy of the background is gone, or does not fit any more
        return str(error)
    return None


def _run(target: LaboratoryTarget, one: FinishedRun, baselines: dict[str, Means], episodes: int) -> dict[str, Any]:
    """A run's part of the file."""
    path = str(one.run.path)
    learned = list(find_saved(path).load)
    # The scripted manager over the same benches: those that have learned are other ones than the background's.
    own = learned != [MANAGER_ROLE]
    scripted = _means(target, f"{path},{MANAGER_ROLE}=heuristic", episodes) if own else baselines["scripted"]
    rewards = one.config.get("rewards")
    scenario = target.scenario if rewards is None else target.scenario.with_rewards(str(rewards))
    return {
        "seed": one.result.seed,
        "steps": one.result.steps,
        "seconds": one.result.seconds,
        "learned": learned,
        "same_task": fingerprint(Laboratories(scenario).role(0)) == one.config.get("fingerprint"),
        **_circumstances(episodes),
        "by_goal": _means(target, path, episodes),
        "scripted": scripted,
    }


def _means(target: LaboratoryTarget, policy: str, episodes: int) -> Means:
    return {goal: _measures(target.play(policy, goal, episodes, RESULT_SEED)) for goal in target.goals}


def _measures(played: Played) -> dict[str, float]:
    values = {"score": played.returns, "safety_cost": played.cost, "ticks": played.lengths, **played.measures}
    return {name: float(values[name].mean()) for name in MEASURES}


# -- writing ----------------------------------------------------------------------------------------------------------


def write_laboratory(folder: Path, out: Path, formats: Sequence[str] = ("png",)) -> LaboratoryPage | None:
    """Write ``laboratory.md`` and the pictures ``laboratory_curves``; nothing is played.

    Args:
        folder: the results, with ``laboratory.json`` if :func:`collect_laboratories` has been there.
        out: where page and pictures go.
        formats: endings that matplotlib knows, such as ``png`` and ``svg``.

    Returns:
        What was written; None, and what earlier results have left in ``out`` goes, where there are neither finished
        runs of managers nor a ``laboratory.json``.

    Raises:
        ValueError: the folder is not there, a file in it is not what was written, or the format is unknown.
        ImportError: matplotlib is not installed.
    """
    groups, content = _groups(folder), _stored(folder)
    tasks: Tasks = {}
    for group in groups:
        for label, runs in group.runs.items():
            begun = [one.run for one in runs if one.run.curve() or one.run.evaluations()]
            if begun:
                tasks.setdefault(f"{group.scenario}, benches {group.background}", {})[label] = begun
    pictures = [out / f"{_CURVES}.{ending}" for ending in formats]
    page = out / _PAGE
    if not groups and content is None:
        for path in (page, *pictures):
            path.unlink(missing_ok=True)
        return None
    for path in pictures:
        if not tasks:
            path.unlink(missing_ok=True)
            continue
        with import_matplotlib().rc_context(SETTINGS):
            save_figure(draw_tasks(tasks), path)
    content = content or {"groups": [], "left_out": []}
    left_out = [
        f"{one['run']}: {one['reason']}" + ("; the table has what was played earlier" if one["kept"] else "")
        for one in content["left_out"]
    ]
    known = {one["run"] for one in (*content["left_out"], *(run for g in content["groups"] for run in g["runs"]))}
    names = [one.run.path.relative_to(folder).as_posix() for group in groups for one in _runs(group)]
    left_out += [f"{name}: not played yet (chemlab figures --collect)" for name in names if name not in known]
    picture = next((path.name for path in pictures if path.exists()), None)
    write_text(page, "\n".join(_markdown(content, left_out, picture)) + "\n")
    return LaboratoryPage(page, left_out)


def _runs(group: _Group) -> Iterator[FinishedRun]:
    for runs in group.runs.values():
        yield from runs


def _markdown(content: dict[str, Any], left_out: Sequence[str], picture: str | None) -> Iterator[str]:
    yield "# Managers of laboratories"
    groups: list[dict[str, Any]] = content["groups"]
    if groups:
        yield ""
        yield (
            f"Best checkpoint of each run, without exploration: {content['episodes_per_goal']} episodes a goal from "
            f"seed {content['seed']}, the same for everybody, which training has not seen. Means over episodes, goals "
            f"and seeds; in brackets {100.0 * statistics.CONFIDENCE:g} % bootstrap intervals over the seeds of "
            "training, where there are several (of a few they are too narrow: of two, they are the two values). "
            "Minus scripted: the score less that of the scripted manager over the same benches. "
            "Safety: weighted safety events. Instruments: what measuring has cost, in units of the score. "
            "Where nothing was submitted, purity is 0. Minutes and steps are those of training, a seed."
        )
    for scenario in dict.fromkeys(group["scenario"] for group in groups):
        yield from ("", f"## {scenario}", "")
        yield (
            "| benches | manager | score | minus scripted | safety | submitted (mol) | purity (%) | instruments "
            "| ticks | seeds | minutes | steps |"
        )
        yield "|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|"
        for group in groups:
            if group["scenario"] == scenario:
                yield from (_line(*cells) for cells in _rows(group))
    notes = [note for group in groups for run in group["runs"] for note in _notes(run, group)]
    if notes:
        yield from ("", "## Notes", "", *(f"- {note}" for note in notes))
    if picture is not None:
        yield from ("", "## Learning curves", "", f"![{_CURVES}]({picture})", "")
        yield (
            "Dashed: the scripted manager. Where a curriculum lets training episodes begin half way, the lines are "
            "above what a whole episode comes to until it is over; the points are whole episodes."
        )
    if left_out:
        yield from ("", "## Left out", "", *(f"- {line}" for line in left_out))


def brief_table(folder: Path, shipped: bool) -> list[str]:
    """The scores of ``laboratory.json`` as the lines of one Markdown table: of what has learned, and of the scripted
    managers.

    Args:
        folder: the results.
        shipped: whether of the scenarios that come with chemlab, or of the others.

    Raises:
        ValueError: there is no ``laboratory.json``, or it is not what was written.
    """
    content = _stored(folder)
    if content is None:
        raise ValueError(f"{folder}: has no {_FILE}; chemlab figures {folder} --collect makes it")
    lines = ["| scenario | benches | manager | score | safety | instruments | seeds | minutes |"]
    lines.append("|---|---|---|--:|--:|--:|--:|--:|")
    for group in content["groups"]:
        if (group["scenario"] in scenario_names()) == shipped:
            kept = {name: means for name, means in group["baselines"].items() if name in ("scripted", "direct")}
            rows = _rows({**group, "baselines": kept})
            for benches, manager, score, _, safety, _, _, instruments, _, seeds, minutes, _ in rows:
                lines.append(
                    _line(f"`{group['scenario']}`", benches, manager, score, safety, instruments, seeds, minutes)
                )
    return lines


def _rows(group: dict[str, Any]) -> Iterator[list[str]]:
    """A group's lines of the table: every label, then the managers that learned nothing."""
    for label in dict.fromkeys(run["label"] for run in group["runs"]):
        runs = [run for run in group["runs"] if run["label"] == label]
        scores = np.array([_overall(run["by_goal"], "score") for run in runs])
        gains = scores - [_overall(run["scripted"], "score") for run in runs]
        others = [role for role in runs[0]["learned"] if role != MANAGER_ROLE]
        yield _cells(
            f"{group['background']}; learned: {', '.join(others)}" if others else group["background"],
            display_name(label),
            _interval(scores, ""),
            _interval(gains, "+"),
            [run["by_goal"] for run in runs],
            str(len(runs)),
            _minutes(float(np.mean([run["seconds"] for run in runs])) / 60.0),
            _span([run["steps"] for run in runs]),
        )
    scripted = group["baselines"].get("scripted")
    for name, means in group["baselines"].items():
        score = _overall(means, "score")
        gain = "" if name == "scripted" else number_text(score - _overall(scripted, "score"), sign="+")
        yield _cells(group["background"], BASELINES[name][1], number_text(score), gain, [means], "", "", "")


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _cells(benches: str, manager: str, score: str, gain: str, means: Sequence[Means], *last: str) -> list[str]:
    """``means`` are those of each seed."""

    def over(measure: str) -> float:
        return float(np.mean([_overall(one, measure) for one in means]))

    cells = [benches, manager, score, gain, number_text(over("safety_cost")), number_text(over("submitted_mol"))]
    return [*cells, f"{100.0 * over('purity'):.1f}", number_text(over("instruments")), f"{over('ticks'):.0f}", *last]


def _overall(means: Means, measure: str) -> float:
    """Mean over goals."""
    return float(np.mean([by_measure[measure] for by_measure in means.values()]))


def _interval(values: Any, sign: str) -> str:
    """Mean over seeds and its interval; one seed has none."""
    return interval_text(statistics.mean([values]).as_dict(), sign=sign)


def _minutes(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.1f}"


def _span(steps: Sequence[int]) -> str:
    low, high = min(steps), max(steps)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def _notes(run: dict[str, Any], group: dict[str, Any]) -> Iterator[str]:
    """What a reader has to know of a run."""
    if any(run[name] != group[name] for name in ("episodes_per_goal", "seed", "versions")):
        yield (
            f"{run['run']}: played earlier than the others, by chemlab {run['versions']['chemlab']}: "
            f"{run['episodes_per_goal']} episodes a goal from seed {run['seed']}"
        )
    if not run["same_task"]:
        yield f"{run['run']}: the scenario has changed since it was trained"
