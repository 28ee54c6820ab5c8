"""The paper's figures from tables alone; matplotlib comes with the extra ``plot``.

Numbers are those of the paper's figures (:data:`FIGURES`). 9, 11 and 13 need traces, the others need runs.
"""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.agents.evaluate.curves import algorithm_style, average_curves
from chemlab.agents.evaluate.results import Cell, display_name
from chemlab.render.figure import SETTINGS, import_matplotlib, new_figure, save_figure

from .measures import best_ratios, mean_ratios
from .results import EXPERIMENTS, Results

_GOALS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000")
_BEHIND_TEXT = {"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.8}


@dataclass(frozen=True)
class FigureSpec:
    """One figure: the stem of its file, its caption and its drawing function."""

    stem: str
    caption: str
    draw: Callable[[Results], Drawn]

    @property
    def number(self) -> int:
        """Number of the figure in the paper."""
        return int(self.stem.split("_")[1])


@dataclass(frozen=True)
class Drawn:
    """A drawn figure and a list of missing results; the figure is None if there is nothing to draw."""

    figure: Any
    missing: list[str]


def _missing_runs(results: Results, key: str) -> list[str]:
    missing = results.missing(key)
    return [f"finished runs of {', '.join(map(display_name, missing))}"] if missing else []


def _note(figure: Any, text: str, missing: list[str]) -> None:
    """Write a note below the axes."""
    lines = textwrap.wrap(text, int(figure.get_figwidth() * 14.5)) + [f"Missing: {what}." for what in missing]
    figure.text(0.01, 0.01, "\n".join(lines), fontsize=8, va="bottom", ha="left", color="#333333")


# -- returns by goal --------------------------------------------------------------------------------------------------


def _short(goal: str) -> str:
    """Break a material's name into lines short enough for the rim of a radar chart."""
    parts = goal.split("-")
    lines = [""]
    for i, part in enumerate(parts):
        piece = part + ("-" if i < len(parts) - 1 else "")
        if lines[-1] and len(lines[-1]) + len(piece) > 14:
            lines.append(piece)
        else:
            lines[-1] += piece
    return "\n".join(lines)


def _radar(results: Results, key: str) -> Drawn:
    cells, missing = results.cells[key], _missing_runs(results, key)
    if not cells:
        return Drawn(None, missing)
    goals = next(iter(cells.values())).goals
    angles = np.linspace(0.0, 2.0 * np.pi, len(goals), endpoint=False)
    closed = np.append(angles, angles[0])
    panels = {
        "(a) best of the runs": {label: best_ratios(cell) for label, cell in cells.items()},
        "(b) mean over the runs": {label: mean_ratios(cell) for label, cell in cells.items()},
    }
    clipped = {
        title: {label: np.maximum(0.0, [ratios[goal] for goal in goals]) for label, ratios in drawn.items()}
        for title, drawn in panels.items()
    }
    top = 1.05 * max(1.0, *(float(np.nanmax(v, initial=0.0)) for drawn in clipped.values() for v in drawn.values()))
    figure = new_figure(12.0, 5.9)
    handles: list[Any] = []
    for place, (title, drawn) in enumerate(clipped.items()):
        axes = figure.add_axes((0.11 + 0.5 * place, 0.21, 0.28, 0.57), projection="polar")
        axes.set_theta_zero_location("N")
        around = np.linspace(0.0, 2.0 * np.pi, 200)
        handles = axes.plot(around, np.ones_like(around), color="black", lw=1.3, ls=(0, (5, 3)), label="scripted")
        for label, ratios in drawn.items():
            look = algorithm_style(label, list(cells))
            handles += axes.plot(
                closed, np.append(ratios, ratios[0]), lw=1.8, marker="o", ms=4, label=_counted(cells[label]), **look
            )
        axes.set_xticks(angles)
        axes.set_xticklabels([])
        axes.set_ylim(0.0, top)
        axes.set_yticks([0.25, 0.5, 0.75, 1.0])
        axes.set_yticklabels(["0.25", "0.5", "0.75", ""], fontsize=8, color="#333333", bbox=_BEHIND_TEXT)
        axes.set_rlabel_position(180.0 / len(goals))
        for angle, goal in zip(angles, goals, strict=True):
            side, height = -np.sin(angle), np.cos(angle)
            across = "center" if abs(side) < 0.1 else "left" if side > 0.0 else "right"
            along = "center" if abs(height) < 0.5 else "bottom" if height > 0.0 else "top"
            axes.text(angle, top * 1.06, _short(goal), ha=across, va=along, fontsize=10)
        axes.set_title(title, pad=28)
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False, bbox_to_anchor=(0.5, 0.085))
    title = EXPERIMENTS[key].title
    figure.suptitle(f"{title}: return for each goal over the scripted policy's", y=0.985)
    text = (
        "Each run is represented by its best policy. Ratios below 0 are drawn as 0. The dashed ring is 1, the scripted "
        "policy."
    )
    _note(figure, text, missing)
    return Drawn(figure, missing)


def _counted(cell: Cell) -> str:
    count = len(cell.runs)
    return f"{display_name(cell.label)} ({count} run{'s' if count != 1 else ''})"


# -- learning curves --------------------------------------------------------------------------------------------------


def _curves(results: Results, key: str) -> Drawn:
    cells, missing = results.cells[key], _missing_runs(results, key)
    if not cells:
        return Drawn(None, missing)
    reaction = key.endswith("rxn")
    figure = new_figure(7.5, 5.6)
    axes = figure.add_axes((0.1, 0.255, 0.87, 0.665))
    single_runs = []
    for label, cell in cells.items():
        curve = average_curves([run.curve for run in cell.runs])
        if curve is None:
            missing.append(f"learning curves of {display_name(label)}")
            continue
        steps, mean, between, single = curve
        look = algorithm_style(label, list(cells))
        axes.plot(steps / 1000.0, mean, lw=1.8, label=_counted(cell), **look)
        band = single / 5.0 if reaction else between
        if np.isfinite(band).all():
            axes.fill_between(steps / 1000.0, mean - band, mean + band, color=look["color"], alpha=0.18, linewidth=0.0)
        else:
            single_runs.append(display_name(label))
    references = [cell.scripted_mean() for cell in cells.values()]
    known = [value for value in references if value is not None]
    if known:
        axes.axhline(float(np.mean(known)), color="black", lw=1.3, ls=(0, (5, 3)), label="scripted")
    random = results.played_mean(key, "random")
    if random is not None:
        axes.axhline(random, color="#777777", lw=1.2, ls=":", label="random actions")
    axes.set_xlabel("training steps, all environments together (thousands)")
    axes.set_ylabel("mean return of training episodes")
    axes.set_xlim(0.0, max(cell.steps for cell in cells.values()) / 1000.0)
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    figure.legend(loc="lower center", ncols=4, frameon=False, bbox_to_anchor=(0.5, 0.075))
    figure.suptitle(f"{EXPERIMENTS[key].title}: learning curves", y=0.975)
    text = (
        "Mean over runs; shaded: a fifth of the standard deviation of single returns, as in the paper."
        if reaction
        else "Mean over runs; shaded: one standard deviation between runs, as in the paper."
    )
    if single_runs and not reaction:
        text += f" One run has no spread: {', '.join(single_runs)}."
    _note(figure, text, missing)
    return Drawn(figure, missing)


# -- actions of policies ----------------------------------------------------------------------------------------------


def _traced(results: Results, key: str) -> tuple[list[str], list[str]]:
    """Return the policies of an experiment with traces, and the missing ones."""
    played = results.traces.get(key, {})
    if not played:
        return [], ["traces (python -m studies.paper --collect RUNS makes them)"]
    algorithms = EXPERIMENTS[key].algorithms
    others = [label for label in played if label not in (*algorithms, "scripted", "random")]
    shown = [label for label in (*algorithms, *others, "scripted") if label in played]
    absent = [display_name(label) for label in algorithms if label not in shown]
    return shown, [f"traces of {', '.join(absent)}"] if absent else []


def _actions(results: Results, key: str) -> Drawn:
    shown, missing = _traced(results, key)
    if not shown:
        return Drawn(None, missing)
    names, goals = EXPERIMENTS[key].action_names, EXPERIMENTS[key].goals
    figure = new_figure(1.2 + 1.75 * len(names), 1.7 + 1.3 * len(shown))
    height = figure.get_figheight()
    grid = figure.subplots(
        len(shown),
        len(names),
        sharex=True,
        sharey=True,
        squeeze=False,
        gridspec_kw={
            "left": 0.085,
            "right": 0.985,
            "top": 1.0 - 0.75 / height,
            "bottom": 1.1 / height,
            "wspace": 0.12,
            "hspace": 0.18,
        },
    )
    lines: list[Any] = []
    for row, label in enumerate(shown):
        lines = []
        for g, goal in enumerate(goals):
            values = np.array(results.traces[key][label][goal][""].actions)
            for column in range(len(names)):
                # Equal curves overlap: each is thinner than the one below it.
                (line,) = grid[row, column].plot(
                    np.arange(len(values)),
                    values[:, column],
                    color=_GOALS[g % len(_GOALS)],
                    lw=3.6 - 0.6 * g,
                    label=goal,
                )
            lines.append(line)
        grid[row, 0].set_ylabel(display_name(label), fontsize=11)
    for column, name in enumerate(names):
        grid[0, column].set_title(name)
        grid[-1, column].set_xlabel("step")
    grid[0, 0].set_ylim(-0.05, 1.05)
    grid[0, 0].set_yticks([0.0, 0.5, 1.0])
    figure.legend(
        handles=lines, loc="lower center", ncols=len(goals), frameon=False, bbox_to_anchor=(0.5, 0.32 / height)
    )
    figure.suptitle(
        f"{EXPERIMENTS[key].title}: average action at each step, one curve for each goal", y=1.0 - 0.1 / height
    )
    text = (
        "Best run of each algorithm, without exploration. Temperature and volume: 0.5 holds, 1 is one step up. "
        "Adding: share of what is left of the reagent."
    )
    _note(figure, text, missing)
    return Drawn(figure, missing)


_TINTS = {
    "drain": "#CFE8F7",
    "mix": "#FCE3B3",
    "pour": "#D3EEDF",
    "add": "#F9D5C2",
    "settle": "#E4DDF0",
    "heat": "#F9D5C2",
    "cool": "#CFE8F7",
    "end": "#D9D9D9",
}
_ACROSS, _DOWN = 9, 3
"""Maximum number of boxes per line, and of lines per sequence."""
_BOX_WIDTH, _BOX_HEIGHT, _LINE_HEIGHT, _LABEL_WIDTH = 1.12, 0.6, 0.92, 1.25


def _words(meaning: str) -> str:
    """Shorten an action's name for a box: 'pour DV -> B1, 10 %' gives 'pour DV→B1' and '10 %'."""
    what, _, how = meaning.partition(", ")
    amount, _, unit = how.partition(" ")
    if unit == "units of settling time":
        how = f"time {amount}"
    elif unit.startswith("%"):
        how = f"{amount} %"
    what = what.replace(" -> ", "→").replace("_", " ").removesuffix(" the experiment")
    if what.startswith("add "):
        what = what.partition(" to ")[0]  # always to the main vessel
    return "\n".join([*textwrap.wrap(what, 13), *([how] if how else [])])


def _boxes(actions: Sequence[int], meanings: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Yield (text, times, tint) of each run of equal actions; a long sequence is truncated."""
    groups = [(action, len(list(same))) for action, same in itertools.groupby(actions)]
    most = _ACROSS * _DOWN
    shown = groups if len(groups) <= most else groups[: most - 1]
    for action, times in shown:
        meaning = meanings[action]
        yield _words(meaning), f"x {times}", _TINTS.get(meaning.replace(",", " ").split()[0], "#EEEEEE")
    left = sum(times for _, times in groups[len(shown) :])
    if left:
        yield f"and {left}\nmore steps", "", "#FFFFFF"


def _sequences(results: Results, key: str, goal: str) -> Drawn:
    shown, missing = _traced(results, key)
    if not shown:
        return Drawn(None, missing)
    traces = {label: results.traces[key][label][goal] for label in shown}
    cases = sorted(traces[shown[0]], reverse=True)
    rows: list[tuple[str, str, list[tuple[str, str, str]]]] = []
    for case in cases:
        for label in shown:
            best = traces[label].get(case)
            if best is None:
                missing.append(f"an episode of {display_name(label)} {case}")
                continue
            title = f"{display_name(label)}\nreturn {best.best_return:.3f}"
            rows.append((case, title, list(_boxes(best.actions, EXPERIMENTS[key].action_names))))
    heading = 0.38 if any(cases) else 0.1
    deep = sum(_LINE_HEIGHT * (1 + (len(boxes) - 1) // _ACROSS) + 0.14 for _, _, boxes in rows)
    widest = max(min(len(boxes), _ACROSS) for _, _, boxes in rows)
    width = _LABEL_WIDTH + _BOX_WIDTH * max(widest, 6) + 0.2
    height = 0.6 + deep + heading * len(cases) + 0.55
    figure = new_figure(width, height)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))  # in inches, from the top left
    axes.set_xlim(0.0, width)
    axes.set_ylim(height, 0.0)
    axes.axis("off")
    y, current = 0.55, None
    for case, title, boxes in rows:
        if case != current:
            current = case
            if case:
                axes.text(0.12, y + 0.16, f"{case} at the start", fontsize=11, fontweight="bold", va="center")
                axes.plot([0.12, width - 0.12], [y + 0.32, y + 0.32], color="#999999", lw=0.8)
            y += heading
        axes.text(0.12, y + _BOX_HEIGHT / 2.0, title, fontsize=10, va="center", linespacing=1.3)
        for i, (text, times, tint) in enumerate(boxes):
            left, top = _LABEL_WIDTH + _BOX_WIDTH * (i % _ACROSS), y + _LINE_HEIGHT * (i // _ACROSS)
            axes.add_patch(_box(left, top, tint))
            middle = left + (_BOX_WIDTH - 0.08) / 2.0
            axes.text(middle, top + _BOX_HEIGHT / 2.0, text, fontsize=8, ha="center", va="center", linespacing=1.15)
            axes.text(middle, top + _BOX_HEIGHT + 0.1, times, fontsize=8.5, ha="center", va="center")
        y += _LINE_HEIGHT * (1 + (len(boxes) - 1) // _ACROSS) + 0.14
    figure.suptitle(f"{EXPERIMENTS[key].title}, goal {goal}: best sequence of actions", y=1.0 - 0.15 / height)
    text = (
        "Best episode of the best run of each algorithm, without exploration; below each action how often it is "
        "repeated."
    )
    _note(figure, text, missing)
    return Drawn(figure, missing)


def _box(left: float, top: float, tint: str) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((left, top), _BOX_WIDTH - 0.08, _BOX_HEIGHT, facecolor=tint, edgecolor="#666666", linewidth=0.7)


# -- all of them ------------------------------------------------------------------------------------------------------

_RADAR = (
    "{} return for each goal relative to the scripted policy, clipped at 0: (a) the run with the highest mean return, "
    "(b) mean over runs; each run's best policy."
)
_CURVES = "{} return of training episodes, mean over runs; shaded: {}. Dashed: the scripted policy."
_SINGLE, _BETWEEN = "a fifth of the standard deviation of single returns", "one standard deviation between runs"
_ACTIONS = (
    "Fictitious RxN, average value of each action at every step, one curve for each goal, best policy of each "
    "algorithm."
)
_SEQUENCES = "{} goal dodecane: sequence of actions with the highest return of each algorithm's best policy{}."

FIGURES: tuple[FigureSpec, ...] = (
    FigureSpec("figure_05_wurtz_rxn_goals", _RADAR.format("Wurtz RxN,"), lambda r: _radar(r, "wurtz_rxn")),
    FigureSpec("figure_06_wurtz_rxn_curves", _CURVES.format("Wurtz RxN,", _SINGLE), lambda r: _curves(r, "wurtz_rxn")),
    FigureSpec(
        "figure_07_fictitious_rxn_goals", _RADAR.format("Fictitious RxN,"), lambda r: _radar(r, "fictitious_rxn")
    ),
    FigureSpec(
        "figure_08_fictitious_rxn_curves",
        _CURVES.format("Fictitious RxN,", _SINGLE),
        lambda r: _curves(r, "fictitious_rxn"),
    ),
    FigureSpec("figure_09_fictitious_rxn_actions", _ACTIONS, lambda r: _actions(r, "fictitious_rxn")),
    FigureSpec("figure_10_wurtz_ext_curves", _CURVES.format("ExT,", _BETWEEN), lambda r: _curves(r, "wurtz_ext")),
    FigureSpec(
        "figure_11_wurtz_ext_sequences",
        _SEQUENCES.format("ExT,", ""),
        lambda r: _sequences(r, "wurtz_ext", "dodecane"),
    ),
    FigureSpec("figure_12_wurtz_dit_curves", _CURVES.format("DiT,", _BETWEEN), lambda r: _curves(r, "wurtz_dit")),
    FigureSpec(
        "figure_13_wurtz_dit_sequences",
        _SEQUENCES.format("DiT,", ", without and with salt at the start"),
        lambda r: _sequences(r, "wurtz_dit", "dodecane"),
    ),
)
"""Every figure of the paper that reports results."""


def write_figures(results: Results, folder: Path) -> dict[str, list[str]]:
    """Draw every figure with results.

    Args:
        results: results of :func:`~studies.paper.chemgymrl.results.read_results`.
        folder: folder of the pictures.

    Returns:
        {stem: missing results, in words}; a figure without any results is not written.

    Raises:
        ImportError: matplotlib is not installed.
    """
    matplotlib = import_matplotlib()
    folder.mkdir(parents=True, exist_ok=True)
    lacking = {}
    for spec in FIGURES:
        with matplotlib.rc_context(SETTINGS):
            drawn = spec.draw(results)
            lacking[spec.stem] = drawn.missing
            path = folder / f"{spec.stem}.png"
            if drawn.figure is None:
                path.unlink(missing_ok=True)  # from earlier results
            else:
                save_figure(drawn.figure, path)
    return lacking
