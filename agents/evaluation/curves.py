"""Learning curves of any training runs, finished or not, with their evaluations beside the scripted policy."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.render.figure import new_figure

from ..runs import Evaluation, Run, find_runs
from .figures import algorithm_style, average_curves
from .results import curve_of, display_name

__all__ = ["Tasks", "draw_curves", "draw_tasks", "group_runs"]

Tasks = dict[str, dict[str, list[Run]]]
"""Runs by task and label (:func:`draw_curves` makes the part's title and the legend of them)."""


_LEGEND_COLUMNS = 3


def group_runs(folders: Sequence[Path]) -> Tasks:
    """The runs in and below some folders that have begun to learn, by task (bench, goals, starting states) and label.

    Raises:
        ValueError: a folder is not there, or has no such run.
    """
    tasks: Tasks = {}
    seen = set()
    for folder in folders:
        if not folder.is_dir():
            raise ValueError(f"{folder}: no such folder of runs")
        runs = [run for run in find_runs(folder) if run.curve() or run.evaluations()]
        if not runs:
            raise ValueError(f"{folder}: has no training run with a learning curve (see chemlab train)")
        for run in runs:
            if run.path.resolve() in seen:
                continue
            seen.add(run.path.resolve())
            config = run.config() or {}
            goals = config.get("goals") or []
            parts = [f"{config.get('scenario')}, {config.get('bench')}"]
            parts += [f"goal {goals[0]}"] if len(goals) == 1 else [f"{len(goals)} goals"] if goals else []
            parts += [f"starts {config['starts']}"] if config.get("starts", "paper") != "paper" else []
            label = str(config.get("label", run.path.name))
            tasks.setdefault(", ".join(parts), {}).setdefault(label, []).append(run)
    return tasks


def draw_curves(folders: Sequence[Path]) -> Any:
    """A figure with a part for each task: training returns, evaluations, the scripted policy.

    Raises:
        ValueError: a folder is not there, or has no run.
        ImportError: matplotlib is not installed.
    """
    return draw_tasks(group_runs(folders))


def draw_tasks(tasks: Tasks) -> Any:
    """The same of runs that have been grouped already, of which every one has a curve or evaluations.

    Raises:
        ImportError: matplotlib is not installed.
    """
    columns = min(len(tasks), 2)
    rows = -(-len(tasks) // columns)
    # Below each part there is room for a legend of two lines.
    lines = max(-(-(len(labels) + 1) // _LEGEND_COLUMNS) for labels in tasks.values())
    deep = 4.1 + 0.2 * max(0, lines - 2)
    width, height = 6.6 * columns, 0.4 + deep * rows
    figure = new_figure(width, height)
    for i, (task, labels) in enumerate(tasks.items()):
        left, top = 6.6 * (i % columns), 0.1 + deep * (i // columns)
        axes = figure.add_axes(((left + 0.8) / width, 1.0 - (top + 3.15) / height, 5.6 / width, 2.75 / height))
        _panel(axes, task, labels)
    text = (
        "Lines: mean return of training episodes, mean over runs; shaded: one standard deviation between runs. "
        "Thin: runs that have gone on longer. Points: evaluations without exploration."
    )
    text = textwrap.fill(text, int(14.5 * width))
    figure.text(0.01, 0.08 / height, text, fontsize=8, color="#333333", va="bottom")
    return figure


def _panel(axes: Any, task: str, labels: dict[str, list[Run]]) -> None:
    scripted = []
    for label, runs in labels.items():
        style = algorithm_style(label, list(labels))
        count = f"{len(runs)} run{'s' if len(runs) != 1 else ''}"
        curves = [curve_of(run) for run in runs]
        curve = average_curves(curves)
        if curve is not None:
            steps, mean, between, _ = curve
            axes.plot(steps / 1000.0, mean, lw=1.5, label=f"{display_name(label)} ({count})", **style)
            if np.isfinite(between).all():
                low, high = mean - between, mean + between
                axes.fill_between(steps / 1000.0, low, high, color=style["color"], alpha=0.15, linewidth=0.0)
            # The mean ends with the shortest run; what the others have come to since is drawn alone.
            for own in curves:
                later = own[own[:, 0] > steps[-1]]
                if len(later):
                    axes.plot(later[:, 0] / 1000.0, later[:, 1], lw=0.7, color=style["color"], alpha=0.5)
        evaluations = [evaluation for run in runs for evaluation in run.evaluations()]
        _points(axes, evaluations, style["color"], None if curve is not None else f"{display_name(label)} ({count})")
        scripted += [e.heuristic_mean for e in evaluations if e.heuristic_mean is not None]
    if scripted:
        axes.axhline(float(np.mean(scripted)), color="black", lw=1.3, ls=(0, (5, 3)), label="heuristic")
    axes.set_title(task)
    axes.set_xlabel("training steps, all environments together (thousands)")
    axes.set_ylabel("mean return")
    axes.set_xlim(left=0.0)
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=_LEGEND_COLUMNS, frameon=False)


def _points(axes: Any, evaluations: Sequence[Evaluation], color: str, label: str | None) -> None:
    """The mean over runs at each step; a single run's where only one has come so far."""
    if not evaluations:
        return
    steps = sorted({evaluation.step for evaluation in evaluations})
    means = [float(np.mean([e.mean for e in evaluations if e.step == step])) for step in steps]
    axes.plot(np.array(steps) / 1000.0, means, ls="", marker="o", ms=5, mfc="white", mec=color, mew=1.5, label=label)
