"""Measures of results that the paper's statements refer to, by name (:data:`MEASURES`)."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from chemlab.agents.evaluate.results import Cell
from chemlab.kernels.arrays import FloatArray

from .results import EXPERIMENTS, Results

Values = Mapping[str, float]
"""Values by goal, reagent or starting state; a single number has the key ''."""
_GOAL, _SALT = "dodecane", ("without NaCl", "with NaCl")


class Measure(NamedTuple):
    """A scalar or vector measure of an algorithm in an experiment.

    Attributes:
        find: computes it from results, the experiment's key and the algorithm's label; None if results are missing.
        text: formats a value.
    """

    find: Callable[[Results, str, str], Values | None]
    text: Callable[[float], str]


def _steps(value: float) -> str:
    return f"{value / 1000.0:.0f}k steps" if np.isfinite(value) else "at the end"


# -- of runs ----------------------------------------------------------------------------------------------------------


def _of_cell(find: Callable[[Cell], float | Values | None]) -> Callable[[Results, str, str], Values | None]:
    """Make a measure of an algorithm's runs."""

    def found(results: Results, key: str, label: str) -> Values | None:
        cell = results.cell(key, label)
        value = None if cell is None else find(cell)
        return {"": float(value)} if isinstance(value, int | float) else value

    return found


def _by_goal(cell: Cell, over_runs: Callable[[FloatArray], FloatArray]) -> Values:
    return dict(zip(cell.goals, over_runs(cell.relative()).tolist(), strict=True))


def best_ratios(cell: Cell) -> Values:
    """Return the returns of the best run relative to the scripted policy's, by goal."""
    return _by_goal(cell, lambda ratios: ratios[cell.runs.index(cell.best)])


def mean_ratios(cell: Cell) -> Values:
    """Return the mean over runs of returns relative to the scripted policy's, by goal."""
    return _by_goal(cell, lambda ratios: ratios.mean(axis=0))


def training_end(cell: Cell, over_runs: Callable[[FloatArray], float], least: int = 1) -> float | None:
    """Return a statistic of the mean training returns in the last tenth of each run's curve."""
    curves = [run.curve for run in cell.runs if len(run.curve)]
    ends = np.array([c[c[:, 0] >= 0.9 * c[-1, 0], 1].mean() for c in curves])
    return float(over_runs(ends)) if len(ends) >= least else None


def _share(cell: Cell) -> float | None:
    reference = cell.scripted_mean()
    return None if reference is None else float(cell.means().mean()) / reference


def _converged(cell: Cell, last: float | None = None) -> float | None:
    """Return the step from which the mean of the evaluations over runs stays near the last one.

    ``last`` is returned if only the last evaluation is near. The tolerance is 5 % of the scripted policy's mean, for
    good and bad algorithms alike. Evaluations have every goal equally often; in training, the mean fluctuates by more
    than the tolerance because returns differ most by goal.
    """
    reference, count = cell.scripted_mean(), min(len(run.evaluations) for run in cell.runs)
    if count < 2 or reference is None:
        return None
    mean = np.mean([[evaluation.mean for evaluation in run.evaluations[:count]] for run in cell.runs], axis=0)
    away = np.flatnonzero(np.abs(mean - mean[-1]) > 0.05 * reference)
    first = 0 if not len(away) else int(away[-1]) + 1
    return last if last is not None and first == count - 1 else float(cell.runs[0].evaluations[first].step)


# -- of actions --------------------------------------------------------------------------------------------------------


def _mean_return(results: Results, key: str, policy: str) -> Values | None:
    """Return the mean return of a policy that does not learn."""
    value = results.scripted_mean(key) if policy == "scripted" else results.played_mean(key, policy)
    return None if value is None else {"": value}


def _added(results: Results, key: str, label: str, goal: str) -> dict[str, FloatArray] | None:
    """Return, by reagent, the share added after each step; actions add shares of the remainder."""
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
    """Return the steps between the last of A, B and C and the last of the other reagents.

    A reagent counts at the step at which 0.9 of it has been added; -inf if that never happens.
    """
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
    """Return the best action sequence for dodecane by starting state, in words."""
    traced = results.trace(key, label)
    if traced is None:
        return None
    names = EXPERIMENTS[key].action_names
    return {case: [names[action] for action in trace.actions] for case, trace in traced[_GOAL].items()}


def _ends_itself(results: Results, key: str, label: str) -> Values | None:
    best = _best_actions(results, key, label)
    return None if best is None else {case: float(did[-1].startswith("end")) for case, did in best.items()}


def _in_common(results: Results, key: str, label: str) -> Values | None:
    """Return the common share of the best sequences with and without salt."""
    best = _best_actions(results, key, label)
    if best is None or not set(_SALT) <= best.keys():
        return None
    plain, salted = (best[case] for case in _SALT)
    return {"": difflib.SequenceMatcher(None, plain, salted, autojunk=False).ratio()}


def _by_start(results: Results, key: str, label: str) -> Values | None:
    """Return the return relative to the scripted policy's by starting state, over goals with both starting states."""
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
    "best run by goal": Measure(_of_cell(best_ratios), _plain),
    "mean of runs by goal": Measure(_of_cell(mean_ratios), _plain),
    "any run by goal": Measure(_of_cell(lambda cell: _by_goal(cell, lambda r: r.max(axis=0))), _plain),
    "lowest run by goal": Measure(_of_cell(lambda cell: _by_goal(cell, lambda r: r.min(axis=0))), _plain),
    "training end": Measure(_of_cell(lambda cell: training_end(cell, np.mean)), _plain),
    "lowest training end": Measure(_of_cell(lambda cell: training_end(cell, np.min)), _plain),
    "spread of training ends": Measure(_of_cell(lambda cell: training_end(cell, lambda e: e.std(ddof=1), 2)), _plain),
    "converged by": Measure(_of_cell(_converged), _steps),
    "converged before the end": Measure(_of_cell(lambda cell: _converged(cell, np.inf)), _steps),
    "added for E": Measure(partial(_added_for, goal="E"), lambda value: f"{value:.2f}"),
    "wait for I": Measure(partial(_wait, goal="I"), lambda v: f"{v:.0f} steps" if np.isfinite(v) else "never"),
    "ends the experiment": Measure(_ends_itself, lambda value: "ends it" if value else "runs to the limit"),
    "in common": Measure(_in_common, lambda value: f"{value:.2f}"),
    "over scripted by start": Measure(_by_start, _plain),
}
