"""Tables and curves of trained managers, compared with untrained ones.

:func:`collect` plays policies and writes tables (those of :mod:`.tables`, and ``managers.csv``);
:func:`write_laboratory` writes a page from tables only.

Runs are aggregated if they have one scenario, one background (policies of the roles that did not learn), one label and
equal settings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import chemlab
from chemlab.agents.evaluate import statistics
from chemlab.agents.evaluate.curves import save_curves, with_curves
from chemlab.agents.evaluate.play import Target
from chemlab.agents.evaluate.results import TrainedRun, display_name, group_runs
from chemlab.agents.evaluate.statistics import interval_text, number_text
from chemlab.agents.policies import make_policies
from chemlab.agents.pretrained import fingerprint
from chemlab.agents.roles import MANAGER_ROLE, role_of
from chemlab.agents.runs import RESULT_SEED
from chemlab.agents.saved import find_saved
from chemlab.config.display import markdown_table
from chemlab.config.files import write_text
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario
from chemlab.lab.engine import Laboratories

from .tables import SCORES, number, read_runs, read_table, write_runs, write_table

EPISODES = 200
"""Number of episodes for each goal."""

MEASURES: tuple[str, ...] = (
    "score",
    "safety_cost",
    "submitted_mol",
    "purity",
    "instruments",
    "ticks",
    "manager_actions",
)
"""Stored means: raw score, weighted safety events (the cost of constrained RL), submitted amount (mol, of all orders),
purity in [0, 1] (0 if nothing was submitted), cost of measurements (in units of the score), and two counts."""

BASELINES: dict[str, tuple[str, str]] = {
    "scripted": ("scripted", "scripted"),
    "scripted:no-extraction": ("scripted:no-extraction", "scripted, without extraction"),
    "plan": ("plan", "best open-loop policy found"),
    "random": ("random", "random legal actions"),
}
"""Untrained managers, {name: (policy, label in the table)}; the background plays the benches.

``python -m studies.paper --collect RUNS`` plays managers that are missing in a table, and removes managers that are
not listed here.
"""

_PAGE, _CURVES, _TABLE = "laboratory.md", "laboratory_curves", "managers.csv"
_COLUMNS = ("scenario", "background", "policy", "run", "goal", "episodes", "seed", "chemlab", "same_task", *MEASURES)
_LEARNED, _SCRIPTED = "learned", "scripted"
Means = dict[str, dict[str, float]]
"""Means by goal and measure."""
Rows = list[dict[str, str]]


@dataclass
class _Group:
    """Runs of one scenario with one background, by label, and their rows of ``managers.csv``."""

    title: str
    scenario: str
    background: str
    labels: dict[str, list[TrainedRun]]
    rows: Rows

    @property
    def runs(self) -> list[TrainedRun]:
        """Runs of all labels."""
        return [run for runs in self.labels.values() for run in runs]

    def of(self, policy: str, run: str = "") -> Rows:
        """Return the rows of a policy (one for each goal); none if it was not played."""
        return [row for row in self.rows if (row["policy"], row["run"]) == (policy, run)]


def has_manager(run: TrainedRun) -> bool:
    """Return True if a run trained a laboratory's manager, alone or with other roles."""
    return MANAGER_ROLE in _trained_roles(run)


def _trained_roles(run: TrainedRun) -> list[str]:
    """Return the trained roles. A run of several roles names roles; a run of one role names an agent or a bench."""
    names = str(run.config.get("bench")).split(",")
    return sorted(names) if len(names) > 1 or names == [MANAGER_ROLE] else [role_of(names[0])]


def _groups(runs: Sequence[TrainedRun], tables: Path | None = None) -> list[_Group]:
    """Return the finished runs of managers, sorted by scenario and background, with their stored rows."""
    played = [] if tables is None else read_table(tables / _TABLE, _COLUMNS)
    managers = [run for run in runs if run.result is not None and has_manager(run)]
    found = []
    for title, labels in sorted(group_runs(managers, lambda run: "{}, benches {}".format(*_where(run))).items()):
        own = {label: sorted(runs, key=lambda run: run.finished.seed) for label, runs in sorted(labels.items())}
        where = _where(next(iter(own.values()))[0])
        rows = [row for row in played if (row["scenario"], row["background"]) == where]
        found.append(_Group(title, *where, own, rows))
    return found


def _where(run: TrainedRun) -> tuple[str, str]:
    """Return the scenario of a run, and the policies of the roles that did not learn."""
    return str(run.config["scenario"]), str(run.config.get("background") or "scripted")


def _means(rows: Rows) -> Means:
    return {row["goal"]: {name: float(row[name]) for name in MEASURES} for row in rows}


# -- playing ----------------------------------------------------------------------------------------------------------


def collect(
    folder: Path,
    tables: Path,
    episodes: int = EPISODES,
    watch: Callable[[str], None] | None = None,
    keep: Callable[[TrainedRun], bool] = lambda _: True,
) -> list[str]:
    """Write tables of the finished runs below a folder, and play the best checkpoints of runs with a manager.

    All policies play the same seeds, which are used neither in training nor for the choice of checkpoints. A run is
    compared with the scripted manager over the same benches, including benches trained with the manager.

    Stored results of other runs, and of runs that cannot be played any more, are kept. Baselines are played again if a
    run of their group is, or if they are missing in the tables.

    Args:
        folder: folder of training runs, or of tables (for which only baselines can be played).
        tables: output folder of the tables.
        episodes: number of episodes for each goal.
        watch: called with the name of each policy that has been played or whose stored results are kept.
        keep: returns True for runs of the folder to include.

    Returns:
        Runs that were not played, and baselines that do not exist for a scenario, with the reason.

    Raises:
        ValueError: the folder does not exist, or a file in it is malformed.
        ImportError: a run was trained with Stable-Baselines3, which is not installed.
    """
    given = [run for run in read_runs(folder) if keep(run)]
    stored = read_runs(tables) if tables.is_dir() else []
    runs = list({run.name: run for run in (*stored, *given)}.values())
    rows: list[Mapping[str, Any]] = []
    left_out: list[str] = []
    for group in _groups(runs, tables):
        group_rows, not_played = _play_group(group, episodes, watch or (lambda _: None))
        rows += group_rows
        left_out += not_played
    write_runs(tables, runs)
    if rows:
        write_table(tables / _TABLE, _COLUMNS, rows)
    return left_out


def _play_group(
    group: _Group, episodes: int, watch: Callable[[str], None]
) -> tuple[list[Mapping[str, Any]], list[str]]:
    """Return a group's rows, new ones of policies that can be played and stored ones of others; and the reasons."""
    reasons = {run.name: _obstacle(group, run) for run in group.runs}
    rows: list[Mapping[str, Any]] = []
    left_out = []
    for name, (policy, _) in BASELINES.items():
        stored = group.of(name)
        try:
            again = not stored or None in reasons.values()
            players = f"{group.background},{MANAGER_ROLE}={policy}"
            rows += _play(group, name, players, episodes) if again else stored
        except ValueError as error:  # the scenario is gone, or does not have such a manager
            left_out.append(f"{group.scenario}, {name}: {error}")
            rows += stored
        watch(f"{group.scenario}: {name}")
    for run in group.runs:
        reason, stored = reasons[run.name], [*group.of(_LEARNED, run.name), *group.of(_SCRIPTED, run.name)]
        rows += _play_run(group, run, episodes) if reason is None else stored
        if reason is not None and (run.folder is not None or not stored):
            left_out.append(f"{run.name}: {reason}{'; the table has what was played earlier' if stored else ''}")
        watch(f"{group.scenario}: {run.name}")
    return rows, left_out


def _play_run(group: _Group, run: TrainedRun, episodes: int) -> list[Mapping[str, Any]]:
    """Return the rows of a run and, if benches were trained as well, of the scripted manager over them."""
    assert run.folder is not None, "runs from tables have an obstacle"
    path, rewards = str(run.folder.path), run.config.get("rewards")
    task = load_scenario(group.scenario, rewards=None if rewards is None else str(rewards))
    same_task = fingerprint(Laboratories(task).manager.workplace) == run.config.get("fingerprint")
    rows = _play(group, _LEARNED, path, episodes, run=run.name, same_task=same_task)
    if _trained_roles(run) != [MANAGER_ROLE]:
        rows += _play(group, _SCRIPTED, f"{path},{MANAGER_ROLE}=scripted", episodes, run=run.name)
    return rows


def _play(
    group: _Group, policy: str, players: str, episodes: int, run: str = "", same_task: bool = True
) -> list[Mapping[str, Any]]:
    """Play ``players`` and return a row for each goal."""
    target = Target(load_scenario(group.scenario))
    common = {"scenario": group.scenario, "background": group.background, "policy": policy, "run": run}
    common |= {"episodes": str(episodes), "seed": str(RESULT_SEED), "chemlab": chemlab.__version__}
    rows: list[Mapping[str, Any]] = []
    for goal in target.goals:
        played = target.play(players, goal, episodes, RESULT_SEED)
        values = {"score": played.returns, "safety_cost": played.cost, "ticks": played.lengths, **played.measures}
        means = {name: number(float(values[name].mean())) for name in MEASURES}
        rows.append({**common, "goal": goal, "same_task": same_task, **means})
    return rows


def _obstacle(group: _Group, run: TrainedRun) -> str | None:
    """Return the reason why a run cannot be played, or None."""
    if run.folder is None:
        return "a table has no checkpoints"
    path, checkpoints = run.folder.path, run.folder.checkpoints
    if run.folder.checkpoint("best") is None and run.folder.checkpoint("last") is None:
        return f"its checkpoints are missing ({checkpoints})"
    try:
        if MANAGER_ROLE not in find_saved(str(path)).load:
            return f"its checkpoint has no manager ({checkpoints})"
        make_policies(str(path), Laboratories(load_scenario(group.scenario)))
    except ValueError as error:  # the scenario or a policy of the background is gone, or does not fit any more
        return str(error)
    return None


# -- writing ----------------------------------------------------------------------------------------------------------


def write_laboratory(folder: Path, out: Path) -> tuple[Path | None, list[str]]:
    """Write ``laboratory.md`` and its picture ``laboratory_curves.png``; nothing is played.

    Args:
        folder: folder of tables that :func:`collect` has written, or of runs, for learning curves only.
        out: output folder.

    Returns:
        Path of the page, and the runs that are not in the table, with the reason. If there are no finished runs of
        managers, the path is None and earlier output in ``out`` is deleted.

    Raises:
        ValueError: the folder does not exist, or a file in it is malformed.
        ImportError: matplotlib is not installed.
    """
    groups = _groups(read_runs(folder), folder)
    tasks = with_curves({group.title: group.labels for group in groups})
    page, picture = out / _PAGE, out / f"{_CURVES}.png"
    for path in [picture] if tasks else [picture, page]:
        path.unlink(missing_ok=True)
    if not groups:
        return None, []
    if tasks:
        save_curves(tasks, [picture])
    left_out = [
        f"{run.name}: not played yet (python -m studies.paper --collect RUNS)"
        for group in groups
        for run in group.runs
        if not group.of(_LEARNED, run.name)
    ]
    write_text(page, "\n".join(_markdown(groups, left_out, picture.name if tasks else None)) + "\n")
    return page, left_out


def _markdown(groups: Sequence[_Group], left_out: Sequence[str], picture: str | None) -> Iterator[str]:
    yield "# Managers of laboratories"
    tables = [(group, list(_rows(group))) for group in groups]
    if any(rows for _, rows in tables):
        episodes, seed = (
            max(int(row[name]) for group in groups for row in group.rows) for name in ("episodes", "seed")
        )
        yield ""
        yield (
            f"Score: raw score ({SCORES}) of the best checkpoint of each run, without exploration: {episodes} episodes "
            f"a goal from seed {seed}, the same for all managers and not used in training. Means over episodes, goals "
            f"and seeds; in brackets {100.0 * statistics.CONFIDENCE:g} % t intervals over the seeds of "
            "training; a single seed has none. "
            "Minus scripted: the score minus that of the scripted manager over the same benches. "
            "Last: score of the last checkpoint in the evaluation at the end of training. "
            "Safety: weighted safety events. Instruments: cost of measurements, in units of the score. "
            "If nothing was submitted, purity is 0. Minutes and steps of training are for each seed."
        )
    for scenario in dict.fromkeys(group.scenario for group, rows in tables if rows):
        lines = [line for group, rows in tables if group.scenario == scenario for line in rows]
        yield from ("", f"## {scenario}", "", *_table(lines, _HEADINGS))
    notes = [note for group in groups for note in _notes(group)]
    if notes:
        yield from ("", "## Notes", "", *(f"- {note}" for note in notes))
    if picture is not None:
        yield from ("", "## Learning curves", "", f"![{_CURVES}]({picture})", "")
        yield (
            "Dashed: the scripted manager. While a curriculum starts training episodes from intermediate states, the "
            "lines are above the returns of complete episodes; the points are complete episodes."
        )
    if left_out:
        yield from ("", "## Left out", "", *(f"- {line}" for line in left_out))


_HEADINGS = (
    *("benches", "manager", "score", "minus scripted", "last", "safety", "submitted (mol)", "purity (%)"),
    *("instruments", "ticks", "seeds", "minutes", "steps"),
)
_BRIEF = ("scenario", "benches", "manager", "score", "last", "safety", "instruments", "seeds", "minutes")
_WORDS = ("scenario", "benches", "manager")


def _table(rows: Sequence[Mapping[str, str]], headings: Sequence[str]) -> list[str]:
    columns = {name: name not in _WORDS for name in headings}
    return markdown_table(columns, ([row.get(name, "") for name in headings] for row in rows))


def brief_table(folder: Path, shipped: bool) -> list[str]:
    """Return a Markdown table of scores of trained, open-loop and scripted managers, as lines.

    Args:
        folder: folder of tables.
        shipped: True for the bundled scenarios, False for the others.

    Raises:
        ValueError: there is no ``managers.csv``, or a table is malformed.
    """
    if not (folder / _TABLE).exists():
        raise ValueError(f"{folder}: has no {_TABLE}; python -m studies.paper --collect RUNS makes it")
    groups = [group for group in _groups(read_runs(folder), folder) if (group.scenario in scenario_names()) == shipped]
    rows = [
        {**row, "scenario": f"`{group.scenario}`"}
        for group in groups
        for row in _rows(group, baselines=("plan", "scripted", "scripted:no-extraction"))
    ]
    return _table(rows, _BRIEF)


def _rows(group: _Group, baselines: Sequence[str] = tuple(BASELINES)) -> Iterator[dict[str, str]]:
    """Yield a group's lines, {heading: cell}: trained managers by label, then untrained ones."""
    scripted = _means(group.of(_SCRIPTED))
    for label, runs in group.labels.items():
        shown = [run for run in runs if group.of(_LEARNED, run.name)]
        if not shown:
            continue
        means = [_means(group.of(_LEARNED, run.name)) for run in shown]
        references = [_means(group.of(_SCRIPTED, run.name)) or scripted for run in shown]
        scores = np.array([_overall(one, "score") for one in means])
        others = [role for role in _trained_roles(shown[0]) if role != MANAGER_ROLE]
        steps = [run.finished.steps for run in shown]
        minutes = float(np.mean([run.finished.seconds for run in shown])) / 60.0
        yield {
            **_cells(f"{group.background}; learned: {', '.join(others)}" if others else group.background, means),
            "manager": display_name(label),
            "score": _interval(scores),
            "minus scripted": _interval(scores - [_overall(one, "score") for one in references], "+"),
            "last": number_text(float(np.mean([run.finished.last_mean for run in shown]))),
            "seeds": str(len(shown)),
            "minutes": f"{minutes:.0f}" if minutes >= 10.0 else f"{minutes:.1f}",
            "steps": f"{min(steps):,}" if min(steps) == max(steps) else f"{min(steps):,} to {max(steps):,}",
        }
    for name in baselines:
        baseline = _means(group.of(name))
        if baseline:
            score = _overall(baseline, "score")
            gain = "" if name == _SCRIPTED else number_text(score - _overall(scripted, "score"), sign="+")
            cells = {"manager": BASELINES[name][1], "score": number_text(score), "minus scripted": gain}
            yield {**_cells(group.background, [baseline]), **cells}


def _cells(benches: str, means: Sequence[Means]) -> dict[str, str]:
    """Return the columns common to all managers; ``means`` holds the means of each seed."""
    mean = {measure: float(np.mean([_overall(one, measure) for one in means])) for measure in MEASURES}
    return {
        "benches": benches,
        "safety": number_text(mean["safety_cost"]),
        "submitted (mol)": number_text(mean["submitted_mol"]),
        "purity (%)": f"{100.0 * mean['purity']:.1f}",
        "instruments": number_text(mean["instruments"]),
        "ticks": f"{mean['ticks']:.0f}",
    }


def _overall(means: Means, measure: str) -> float:
    """Return the mean of a measure over goals."""
    return float(np.mean([by_measure[measure] for by_measure in means.values()]))


def _interval(values: Any, sign: str = "") -> str:
    """Format the mean over seeds and its interval; a single seed has none."""
    return str(interval_text(statistics.mean([values]).as_dict(), sign=sign))


def _notes(group: _Group) -> Iterator[str]:
    """Yield notes on runs that were played under other conditions or trained on another task."""
    conditions = ("episodes", "seed", "chemlab")
    scripted = group.of(_SCRIPTED)
    for run in group.runs:
        for row in group.of(_LEARNED, run.name)[:1]:
            if scripted and any(row[name] != scripted[0][name] for name in conditions):
                yield (
                    f"{run.name}: played earlier than the others, by chemlab {row['chemlab']}: "
                    f"{row['episodes']} episodes a goal from seed {row['seed']}"
                )
            if row["same_task"] != "True":
                yield f"{run.name}: the scenario has changed since it was trained"
