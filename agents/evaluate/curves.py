"""Learning curves of training runs, finished or not, with evaluations and the scripted policy's score."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.kernels.arrays import FloatArray
from chemlab.render.figure import SETTINGS, import_matplotlib, new_figure, save_figure

from .results import Groups, TrainedRun, display_name, group_runs, read_runs

# Okabe and Ito's palette for colour-blind readers; line styles distinguish the curves without colour.
_STYLES: dict[str, tuple[str, Any]] = {
    "ppo-xl": ("#56B4E9", "-"),
    "ppo": ("#0072B2", "-"),
    "a2c": ("#E69F00", "--"),
    "dqn": ("#009E73", "-."),
    "sac": ("#D55E00", "-."),
    "td3": ("#CC79A7", (0, (3, 1, 1, 1, 1, 1))),
}
_MORE = ("#882255", "#999933", "#332288")
"""Colours of Paul Tol's muted palette, for further labels when all colours of the algorithms are taken."""
_GRID = 200
"""Number of points of a learning curve."""
_LEGEND_COLUMNS = 3


def algorithm_style(label: str, labels: Sequence[str]) -> dict[str, Any]:
    """Return colour and line style of a label: fixed ones for algorithms, free colours for other labels."""
    if label in _STYLES:
        colour, line = _STYLES[label]
        return {"color": colour, "linestyle": line}
    taken = {_STYLES[name][0] for name in labels if name in _STYLES}
    free = [colour for colour, _ in reversed(list(_STYLES.values())) if colour not in taken] + list(_MORE)
    number = [name for name in labels if name not in _STYLES].index(label)
    return {"color": free[number % len(free)], "linestyle": (0, (8, 1.5) + (1, 1.5) * (number % 3))}


def average_curves(curves: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
    """Average learning curves [P, 3] of step, mean and standard deviation on a common grid of G steps.

    Returns:
        Steps [G]; mean return over runs [G]; sample standard deviation of the runs' means [G] (NaN for one run);
        standard deviation of single returns within and between runs [G]. None if no run has a curve.
    """
    curves = [curve for curve in curves if len(curve)]
    if not curves:
        return None
    first, last = max(curve[0, 0] for curve in curves), min(curve[-1, 0] for curve in curves)
    steps = np.linspace(first, max(first, last), _GRID)
    means = np.array([np.interp(steps, curve[:, 0], curve[:, 1]) for curve in curves])
    deviations = np.array([np.interp(steps, curve[:, 0], curve[:, 2]) for curve in curves])
    between = means.std(axis=0, ddof=1) if len(curves) > 1 else np.full(_GRID, np.nan)
    single = np.sqrt((deviations**2).mean(axis=0) + means.var(axis=0))
    return steps, means.mean(axis=0), between, single


def with_curves(groups: Groups) -> Groups:
    """Return the groups without runs that have neither a curve nor evaluations."""
    found: Groups = {}
    for task, labels in groups.items():
        for label, runs in labels.items():
            if drawn := [run for run in runs if len(run.curve) or run.evaluations]:
                found.setdefault(task, {})[label] = drawn
    return found


def draw_curves(folders: Sequence[Path]) -> Any:
    """Draw a figure with a panel for each task: training returns, evaluations, the scripted policy.

    Raises:
        ValueError: a folder does not exist, or has no run with a learning curve.
        ImportError: matplotlib is not installed.
    """
    runs: dict[Path, TrainedRun] = {}
    for folder in folders:
        in_folder = {(folder / run.name).resolve(): run for run in read_runs(folder)}
        if not with_curves(group_runs(in_folder.values())):
            raise ValueError(f"{folder}: has no training run with a learning curve (see chemlab train)")
        runs |= in_folder
    return _draw_groups(with_curves(group_runs(runs.values())))


def save_curves(groups: Groups, paths: Iterable[Path]) -> None:
    """Draw the figure of :func:`draw_curves` for grouped runs, and save it to each path.

    Raises:
        ValueError: the format is unknown.
        ImportError: matplotlib is not installed.
    """
    for path in paths:
        with import_matplotlib().rc_context(SETTINGS):
            save_figure(_draw_groups(groups), path)


def _draw_groups(groups: Groups) -> Any:
    columns = min(len(groups), 2)
    rows = -(-len(groups) // columns)
    # Below each panel there is room for a legend of two lines.
    lines = max(-(-(len(labels) + 1) // _LEGEND_COLUMNS) for labels in groups.values())
    row_height = 4.1 + 0.2 * max(0, lines - 2)
    width, height = 6.6 * columns, 0.4 + row_height * rows
    figure = new_figure(width, height)
    for i, (task, labels) in enumerate(groups.items()):
        left, top = 6.6 * (i % columns), 0.1 + row_height * (i // columns)
        axes = figure.add_axes(((left + 0.8) / width, 1.0 - (top + 3.15) / height, 5.6 / width, 2.75 / height))
        _panel(axes, task, labels)
    text = (
        "Lines: mean return of training episodes, mean over runs; shaded: one standard deviation between runs. "
        "Thin: runs that have gone on longer. Points: evaluations without exploration."
    )
    text = textwrap.fill(text, int(14.5 * width))
    figure.text(0.01, 0.08 / height, text, fontsize=8, color="#333333", va="bottom")
    return figure


def _panel(axes: Any, task: str, labels: dict[str, list[TrainedRun]]) -> None:
    """Draw the curves and evaluations of one task."""
    scripted = []
    for label, runs in labels.items():
        style = algorithm_style(label, list(labels))
        entry = f"{display_name(label)} ({len(runs)} run{'s' if len(runs) != 1 else ''})"
        average = average_curves([run.curve for run in runs])
        if average is not None:
            steps, mean, between, _ = average
            axes.plot(steps / 1000.0, mean, lw=1.5, label=entry, **style)
            if np.isfinite(between).all():
                low, high = mean - between, mean + between
                axes.fill_between(steps / 1000.0, low, high, color=style["color"], alpha=0.15, linewidth=0.0)
            # The mean ends with the shortest run; the rest of longer runs is drawn separately.
            for run in runs:
                rest = run.curve[run.curve[:, 0] > steps[-1]]
                if len(rest):
                    axes.plot(rest[:, 0] / 1000.0, rest[:, 1], lw=0.7, color=style["color"], alpha=0.5)
        evaluations = [evaluation for run in runs for evaluation in run.evaluations]
        if evaluations:
            # At each step, the mean over the runs that have an evaluation there.
            at = sorted({evaluation.step for evaluation in evaluations})
            means = [float(np.mean([e.mean for e in evaluations if e.step == step])) for step in at]
            points = {"marker": "o", "ms": 5, "mfc": "white", "mec": style["color"], "mew": 1.5}
            axes.plot(np.array(at) / 1000.0, means, ls="", label=entry if average is None else None, **points)
        scripted += [e.scripted_mean for e in evaluations if e.scripted_mean is not None]
    if scripted:
        axes.axhline(float(np.mean(scripted)), color="black", lw=1.3, ls=(0, (5, 3)), label="scripted")
    axes.set_title(task)
    axes.set_xlabel("training steps, all environments together (thousands)")
    axes.set_ylabel("mean return")
    axes.set_xlim(left=0.0)
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=_LEGEND_COLUMNS, frameon=False)
