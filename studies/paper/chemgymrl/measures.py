"""Numbers of results that the paper's statements are about, by name (:data:`MEASURES`)."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from chemlab.agents.evaluate.results import Cell
from chemlab.kernels.arrays import FloatArray

from .results import EXPERIMENTS, Results

__all__ = ["MEASURES", "Measure", "Values"]

Values = Mapping[str, float]
"""By what there are several of (goals, reagents, starting states); a single number stands under ''."""
_GOAL, _SALT = "dodecane", ("without NaCl", "with NaCl")


class Measure(NamedTuple):
    """A number, or several, of an algorithm in an experiment.

    Attributes:
        find: from results, the experiment's key and the algorithm's label; None where results are missing.
        text: how a value is written.
    """

    find: Callable[[Results, str, str], Values | None]
    text: Callable[[float], str]


def _steps(value: float) -> str:
    return f"{value / 1000.0:.0f}k steps" if np.isfinite(value) else "at the end"


# -- of runs ----------------------------------------------------------------------------------------------------------


def _of_cell(find: Callable[[Cell], float | Values | None]) -> Callable[[Results, str, str], Values | None]:
    """A measure of an algorithm's runs."""

    def found(results: Results, key: str, label: str) -> Values | None:
        cell = results.cell(key, label)
        value = None if cell is None else find(cell)
        return {"": float(value)} if isinstance(value, int | float) else value

    return found


def _by_goal(cell: Cell, over_runs: Callable[[FloatArray], FloatArray]) -> Values:
    return dict(zip(cell.goals, over_runs(cell.relative()).tolist(), strict=True))


def _ends(cell: Cell, over_runs: Callable[[FloatArray], float], least: int = 1) -> float | None:
    """Of the mean training returns at the end of each run."""
    ends = cell.training_ends()
    return float(over_runs(ends)) if len(ends) >= least else None


def _share(cell: Cell) -> float | None:
    reference = cell.scripted_mean()
    return None if reference is None else float(cell.means().mean()) / reference


def _converged(cell: Cell, last: float | None = None) -> float | None:
    """The step from which on the mean over runs of the evaluations stays near the last one's; ``last`` where that is
    the last itself. Near: within a twentieth of the scripted policy's mean, for good and bad algorithms alike.

    Evaluations have every goal equally often. In training, chance alone moves the mean by more than that, since
    returns differ most by goal.
    """
    reference, count = cell.scripted_mean(), min(len(run.evaluations) for run in cell.runs)
    if count < 2 or reference is None:
        return None
    mean = np.mean([[evaluation.mean for evaluation in run.evaluations[:count]] for run in cell.runs], axis=0)
    away = np.flatnonzero(np.abs(mean - mean[-1]) > 0.05 * reference)
    first = 0 if not len(away) else int(away[-1]) + 1
    return last if last is not None and first == count - 1 else float(cell.runs[0].evaluations[first].step)


# -- of what policies do ----------------------------------------------------------------------------------------------


def _mean_return(results: Results, key: str, policy: str) -> Values | None:
    """Of a policy that learns nothing."""
    value = results.scripted_mean(key) if policy == "scripted" else results.played_mean(key, policy)
    return None if value is None else {"": value}


def _added(results: Results, key: str, label: str, goal: str) -> dict[str, FloatArray] | None:
    """By reagent the share of it that has been added after each step: actions add shares of what is left."""
    traced = results.trace(key, label)
    if traced is None:
        return None
    actions = np.array(traced[goal][""].actions, dtype=np.float64)
    return {
        name.removeprefix("add "): np.subtract(1.0, np.cumprod(1.0 - actions[:, column]))
        for column, name in enumerate(EXPERIMENTS[key].action_names)
        if name.startswith("add ")
    }


def _added_for(results: Results, key: str, label: str, goal: str) -> Values | None:
    added = _added(results, key, label, goal)
    return None if added is None else {name: float(after[-1]) for name, after in added.items()}


def _wait(results: Results, key: str, label: str, goal: str) -> Values | None:
    """Steps between the last of A, B and C and the last of the others, each when 0.9 of it has been added; less than
    any number where that never is."""
    added = _added(results, key, label, goal)
    if added is None:
        return None
    reached = {name: np.flatnonzero(after >= 0.9) for name, after in added.items()}
    if any(not len(steps) for steps in reached.values()):
        return {"": -np.inf}
    first = {name: int(steps[0]) for name, steps in reached.items()}
    *others, last = sorted(first[name] for name in "ABC")
    return {"": float(last - max(*others, first["D"]))}


def _best_actions(results: Results, key: str, label: str) -> dict[str, list[str]] | None:
    """By starting state the best sequence for dodecane, in words."""
    traced = results.trace(key, label)
    if traced is None:
        return None
    names = EXPERIMENTS[key].action_names
    return {case: [names[action] for action in trace.actions] for case, trace in traced[_GOAL].items()}


def _ends_itself(results: Results, key: str, label: str) -> Values | None:
    best = _best_actions(results, key, label)
    return None if best is None else {case: float(did[-1].startswith("end")) for case, did in best.items()}


def _in_common(results: Results, key: str, label: str) -> Values | None:
    """How much of the best sequences with and without salt is the same."""
    best = _best_actions(results, key, label)
    if best is None or not set(_SALT) <= best.keys():
        return None
    plain, salted = (best[case] for case in _SALT)
    return {"": difflib.SequenceMatcher(None, plain, salted, autojunk=False).ratio()}


def _by_start(results: Results, key: str, label: str) -> Values | None:
    """Return over the scripted policy's by starting state, over the goals that meet both."""
    ours, scripted = results.trace(key, label), results.trace(key, "scripted")
    goals = [goal for goal, cases in (ours or {}).items() if set(_SALT) <= cases.keys()]
    if ours is None or scripted is None or not goals:
        return None

    totals = [[sum(own[goal][case].mean_return for goal in goals) for own in (ours, scripted)] for case in _SALT]
    return {case: mine / theirs for case, (mine, theirs) in zip(_SALT, totals, strict=True)}


def _plain(value: float) -> str:
    return f"{value:.3f}"


MEASURES: dict[str, Measure] = {
    "mean return": Measure(_mean_return, _plain),
    "mean of runs": Measure(_of_cell(lambda cell: float(cell.means().mean())), _plain),
    "best run": Measure(_of_cell(lambda cell: float(cell.means().max())), _plain),
    "lowest run": Measure(_of_cell(lambda cell: float(cell.means().min())), _plain),
    "scripted": Measure(_of_cell(Cell.scripted_mean), _plain),
    "share of scripted": Measure(_of_cell(_share), lambda value: f"{value:.2f}"),
    "best run by goal": Measure(_of_cell(Cell.best_ratios), _plain),
    "mean of runs by goal": Measure(_of_cell(Cell.mean_ratios), _plain),
    "any run by goal": Measure(_of_cell(lambda cell: _by_goal(cell, lambda r: r.max(axis=0))), _plain),
    "lowest run by goal": Measure(_of_cell(lambda cell: _by_goal(cell, lambda r: r.min(axis=0))), _plain),
    "training end": Measure(_of_cell(lambda cell: _ends(cell, np.mean)), _plain),
    "lowest training end": Measure(_of_cell(lambda cell: _ends(cell, np.min)), _plain),
    "spread of training ends": Measure(_of_cell(lambda cell: _ends(cell, lambda e: e.std(ddof=1), 2)), _plain),
    "converged by": Measure(_of_cell(_converged), _steps),
    "converged before the end": Measure(_of_cell(lambda cell: _converged(cell, np.inf)), _steps),
    "added for E": Measure(partial(_added_for, goal="E"), lambda value: f"{value:.2f}"),
    "wait for I": Measure(partial(_wait, goal="I"), lambda v: f"{v:.0f} steps" if np.isfinite(v) else "never"),
    "ends the experiment": Measure(_ends_itself, lambda value: "ends it" if value else "runs to the limit"),
    "in common": Measure(_in_common, lambda value: f"{value:.2f}"),
    "over scripted by start": Measure(_by_start, _plain),
}
