"""Charts of a record: timeline of all agents, spectra of reaction experiments and mole balance. Needs matplotlib.

The colours are the colour-blind safe palette of Okabe and Ito, and the materials' own colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import isotonic_regression

from ..config.materials import Material
from ..config.scenario import Scenario
from ..kernels.arrays import FloatArray
from ..lab.engine import Laboratories
from ..lab.text import action_words, blank_channels
from ..physics.chemistry import WAVELENGTHS_NM
from ..record import Record, RecordError, recorded_scenario
from ..roles.bench import channel_slices
from ..roles.manager_state import COST_WORDS
from .draw import FAINT, INK, SOFT
from .figure import new_figure
from .history import RecordReplay
from .mole_balance import PLACES, Balance, Group, mole_balance

_COLORS = {
    "start": "#009E73",
    "measure": "#56B4E9",
    "discard": "#D55E00",
    "submit": "#000000",
    "recall": "#CC79A7",
    "calibrate": "#0072B2",
    "repair": "#E69F00",
    "wait": "#D9D9D9",
    "drain": "#0072B2",
    "mix": "#E69F00",
    "pour": "#009E73",
    "add": "#CC79A7",
    "settle": "#D9D9D9",
    "hold": "#D9D9D9",
    "heat": "#D55E00",
    "cool": "#56B4E9",
    "end": "#000000",
}
"""Colours of kinds of actions. Kinds share a colour only if no agent has both."""
_OTHER, _INVALID = "#999999", "#FFFFFF"
_LINES = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000", _OTHER)
_LONGEST_TITLE = 62
"""Number of characters of a scenario's title that fit a figure."""


def spread(wanted: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Return positions near the wanted ones (ascending), at least ``gap`` apart and within [low, high] if possible."""
    if not wanted:
        return []
    steps = min(gap, (high - low) / max(len(wanted) - 1, 1)) * np.arange(len(wanted))
    nearest = isotonic_regression(np.array(wanted) - steps).x  # least squares
    positions: list[float] = (np.clip(nearest, low, high - steps[-1]) + steps).tolist()
    return positions


def _plain(axes: Any) -> None:
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _title(record: Record, scenario: Scenario) -> str:
    seed, title = record.header.get("seed"), scenario.title
    title = title if len(title) <= _LONGEST_TITLE else f"{title[: _LONGEST_TITLE - 1]}…"
    return f"{title}{'' if seed is None else f', seed {seed}'}"


@dataclass
class _Strip:
    """Consecutive actions of one kind of one agent, from unit ``start`` to ``stop``."""

    start: int
    stop: int
    kind: str
    invalid: bool


@dataclass
class _Timeline:
    """A record on a time axis of units: one unit for each manager action and one for each tick."""

    labs: Laboratories
    strips: dict[str, list[_Strip]]
    experiments: list[tuple[str, int, int, str, float | None]] = field(default_factory=list)
    """(agent, start, stop, goal, score)"""
    decisions: list[tuple[int, str]] = field(default_factory=list)
    """(unit, words) of each manager action"""
    ticks: list[int] = field(default_factory=list)
    """[units + 1] tick at the beginning of each unit"""
    costs: list[list[float]] = field(default_factory=list)
    """[units + 1][items] cumulative costs"""
    rewards: list[list[float]] = field(default_factory=list)
    """[units + 1][agents] cumulative rewards"""
    over: bool = False


def _kind(labs: Laboratories, agent: int, action: Any) -> str:
    """Return the kind of an action, a key of :data:`_COLORS`."""
    if agent == labs.manager.index:
        return str(labs.actions.decode(int(action))[0])
    words = action_words(labs, agent, action)
    if labs.action_counts[agent]:
        return words.replace(",", " ").split()[0]
    if "add" in words:
        return "add"
    return "heat" if "temperature up" in words else "cool" if "temperature down" in words else "hold"


def _timeline(record: Record, trust: bool) -> _Timeline:
    """Replay a record and return its timeline."""
    replay = RecordReplay(record, trust)
    labs = replay.laboratories
    timeline = _Timeline(labs, {agent: [] for agent in labs.agents})
    running: dict[str, tuple[int, str]] = {}
    rewards = np.zeros(len(labs.agents))
    unit, tick, costs = 0, 0, list(labs.costs().values())

    def end_unit() -> None:
        timeline.ticks.append(tick)
        timeline.costs.append(costs)
        timeline.rewards.append(rewards.tolist())

    end_unit()
    open_tick = False
    for move in replay.moves():
        by_manager = move.plays[0].agent == labs.manager.index
        if open_tick and (by_manager or move.tick != tick):  # the open tick has ended
            unit, open_tick = unit + 1, False
            tick = move.tick
            end_unit()  # with the costs and rewards before this move
        costs = list(labs.costs().values())
        for play in move.plays:
            agent, kind = labs.agents[play.agent], _kind(labs, play.agent, play.action)
            strips, invalid = timeline.strips[agent], agent in move.lost
            # Equal actions of a bench in consecutive units form one strip.
            if strips and not by_manager and strips[-1] == _Strip(strips[-1].start, unit, kind, invalid):
                strips[-1].stop = unit + 1
            else:
                strips.append(_Strip(unit, unit + 1, kind, invalid))
        rewards += labs.rewards[0]
        if by_manager:
            timeline.decisions.append((unit, action_words(labs, labs.manager.index, move.plays[0].action)))
        if move.started:
            experiments = labs.experiments[labs.bench_agents.index(move.started)]
            running[move.started] = (unit + 1, labs.scenario.goals[int(experiments.goal[0])])
        for agent, score in move.scores.items():
            start, goal = running.pop(agent)
            timeline.experiments.append((agent, start, unit if by_manager else unit + 1, goal, score))
        if by_manager:
            unit, tick = unit + 1, int(labs.state.ticks[0])
            end_unit()
        else:
            open_tick = True
    if open_tick:
        unit, tick = unit + 1, int(labs.state.ticks[0])
        end_unit()
    # The last move may have changed rewards and costs after the end of the last unit.
    timeline.costs[-1], timeline.rewards[-1] = costs, rewards.tolist()
    timeline.experiments += [(agent, start, unit, goal, None) for agent, (start, goal) in running.items()]
    timeline.over = replay.over
    return timeline


def draw_timeline(record: Record, trust: bool = False) -> Any:
    """Draw a timeline: actions of every agent, experiments, and cumulative costs and rewards.

    Args:
        record: A record, finished or not.
        trust: Allow imports of code that the record names.

    Raises:
        RecordError: the record cannot be replayed here or has no turn.
        ImportError: matplotlib is not installed.
    """
    timeline = _timeline(record, trust)
    labs, units = timeline.labs, len(timeline.ticks) - 1
    if not units:
        raise RecordError(f"{record.path}: has no turns to draw")
    agents = labs.agents
    rows = min(-(-len(timeline.decisions) // 3), 14)
    listed = timeline.decisions[: 3 * 14 - (len(timeline.decisions) > 3 * 14)]
    lanes, graph, text = 0.42 * len(agents), 1.7, 0.163 * rows + 0.15
    width = min(max(12.0, 1.2 + 0.13 * units), 24.0)
    height = 0.95 + lanes + 0.85 + graph + 0.6 + text
    figure = new_figure(width, height)

    def place(top: float, tall: float, left: float, wide: float) -> tuple[float, float, float, float]:
        return left / width, 1.0 - (top + tall) / height, wide / width, tall / height

    axes = figure.add_axes(place(0.95, lanes, 0.95, width - 1.2))
    _lanes(axes, timeline, units, (width - 1.2) / units)
    _key(figure, timeline, height)
    top = 0.95 + lanes + 0.85
    half = (width - 4.6) / 2.0
    at = np.arange(units + 1)
    costs = figure.add_axes(place(top, graph, 0.95, half))
    items = [(name, line) for name, line in zip(COST_WORDS, np.array(timeline.costs).T, strict=True) if line[-1] > 0.0]
    if items:
        costs.stackplot(at, [line for _, line in items], labels=[name for name, _ in items],
                        colors=_LINES[: len(items)], step="post", linewidth=0.0)  # fmt: skip
        handles, labels = costs.get_legend_handles_labels()
        costs.legend(handles[::-1], labels[::-1], loc="upper left", bbox_to_anchor=(1.0, 1.05), frameon=False)
    costs.set_title("manager's cumulative costs (score)", loc="left", fontsize=10)
    costs.set_ylim(bottom=0.0)
    rewards = figure.add_axes(place(top, graph, 0.95 + half + 2.1, half))
    for i, (agent, line) in enumerate(zip(agents, np.array(timeline.rewards).T, strict=True)):
        rewards.step(at, line, where="post", color=_LINES[i % len(_LINES)], lw=1.8, label=agent,
                     ls=("-", "--", "-.", ":")[i % 4])  # fmt: skip
    rewards.axhline(0.0, color=FAINT, lw=0.6)
    rewards.legend(loc="upper left", bbox_to_anchor=(1.0, 1.05), frameon=False)
    rewards.set_title("cumulative rewards", loc="left", fontsize=10)
    for other in (costs, rewards):
        _plain(other)
        other.set_xlim(0, units)
        other.grid(alpha=0.25)
        _tick_labels(other, timeline, 5)
    _decisions(figure, timeline, listed, rows, text / height)
    figure.suptitle(f"{_title(record, labs.scenario)}: {'the episode' if timeline.over else 'the episode so far'}",
                    y=1.0 - 0.12 / height)  # fmt: skip
    return figure


def _lanes(axes: Any, timeline: _Timeline, units: int, inches: float) -> None:
    """Draw one lane for each agent, with its actions, experiments and the numbers of the manager's decisions."""
    agents = timeline.labs.agents
    for agent, start, stop, _, _ in timeline.experiments:
        axes.broken_barh([(start, stop - start)], (agents.index(agent) - 0.42, 0.84), facecolor="#eef1f4",
                         edgecolor=SOFT, linewidth=0.8)  # fmt: skip
    for lane, agent in enumerate(agents):
        for strip in timeline.strips[agent]:
            color = _INVALID if strip.invalid else _COLORS.get(strip.kind, _OTHER)
            low, tall = (lane - 0.36, 0.72) if lane == 0 else (lane + 0.02, 0.34)
            axes.broken_barh([(strip.start, strip.stop - strip.start)], (low, tall), facecolor=color,
                             edgecolor=SOFT if strip.invalid else "white", linewidth=0.5,
                             hatch="////" if strip.invalid else None)  # fmt: skip
    for number, (unit, _) in enumerate(timeline.decisions, start=1):
        size = min(7.5, 96.0 * inches / len(str(number)))
        if size < 4.5:  # Too small to read: label only the first of consecutive decisions, above the strip.
            if number == 1 or timeline.decisions[number - 2][0] != unit - 1:
                axes.text(unit, -0.42, str(number), fontsize=6.5, ha="left", va="bottom", color=SOFT)
            continue
        strip = timeline.strips[timeline.labs.manager.name][number - 1]
        dark = strip.kind in ("submit", "start", "discard") and not strip.invalid
        axes.text(unit + 0.5, 0, str(number), fontsize=size, ha="center", va="center", color="white" if dark else INK)
    for agent, start, stop, goal, score in timeline.experiments:
        options = [goal if score is None else f"{goal} {score:+.2f}", goal, ""]
        room = ((stop - start) * inches - 0.12) / 0.072
        text = next(option for option in options if len(option) <= max(room, 0.0))
        axes.text(start + 0.08 / inches, agents.index(agent) - 0.2, text, fontsize=7.5, va="center", color=INK)
    axes.set_yticks(range(len(agents)), agents)
    axes.set_ylim(len(agents) - 0.4, -0.6)
    axes.set_xlim(0, units)
    axes.tick_params(axis="y", length=0)
    _plain(axes)
    axes.spines["left"].set_visible(False)
    _tick_labels(axes, timeline, 16)


def _tick_labels(axes: Any, timeline: _Timeline, most: int) -> None:
    """Label the axis with at most ``most`` laboratory ticks, each at the unit where it begins."""
    first = {tick: unit for unit, tick in reversed(list(enumerate(timeline.ticks)))}
    last = timeline.ticks[-1]
    step = next(s for s in (1, 2, 5, 10, 20, 50, 100, 200, 500, 10**6) if last / s <= most)
    shown = [tick for tick in range(0, last + 1, step) if tick in first]
    axes.set_xticks([first[tick] for tick in shown], [str(tick) for tick in shown])
    axes.set_xlabel("tick (manager actions take width on this axis, but no ticks)" if most > 5 else "tick")


def _key(figure: Any, timeline: _Timeline, height: float) -> None:
    """Draw the key to the colours of actions, for the manager and for the benches."""
    from matplotlib.patches import Patch

    manager = timeline.labs.manager.name
    benches = [strip for agent, strips in timeline.strips.items() if agent != manager for strip in strips]
    for left, title, strips in ((0.075, "manager", timeline.strips[manager]), (0.535, "benches", benches)):
        kinds = dict.fromkeys(strip.kind for strip in strips)
        handles = [Patch(facecolor=_COLORS.get(kind, _OTHER), label=kind) for kind in kinds]
        if title == "benches" and any(strip.invalid for strip in (*timeline.strips[manager], *benches)):
            handles.append(Patch(facecolor=_INVALID, edgecolor=SOFT, hatch="////", label="invalid action"))
        if handles:
            figure.legend(
                handles=handles, loc="upper left", ncols=len(handles), frameon=False, title=f"{title}:",
                bbox_to_anchor=(left, 1.0 - 0.38 / height), fontsize=8, columnspacing=0.9, handlelength=1.0,
                handletextpad=0.4, alignment="left", title_fontsize=8, borderpad=0.0,
            )  # fmt: skip


def _decisions(figure: Any, timeline: _Timeline, listed: Sequence[tuple[int, str]], rows: int, share: float) -> None:
    """Print the manager's decisions as a numbered list in three columns."""
    more = len(timeline.decisions) - len(listed)
    lines = [f"{number}  {words}" for number, (_, words) in enumerate(listed, start=1)]
    lines += [f"and {more} more"] if more else []
    for column in range(3):
        part = "\n".join(lines[column * rows : (column + 1) * rows])
        figure.text(0.02 + column * 0.33, share * 0.97, part, fontsize=8, va="top", color=SOFT, linespacing=1.35)


@dataclass(frozen=True)
class _Reaction:
    """A reaction experiment: spectra before and after it, and the vessel's final contents."""

    agent: str
    tick: int
    goal: str
    score: float | None
    before: FloatArray
    after: FloatArray
    contents: FloatArray
    """[materials] mol at the end"""


def _reactions(record: Record, trust: bool) -> tuple[Laboratories, list[_Reaction]]:
    """Replay a record, and return its laboratories and its reaction experiments in the order of their ends."""
    replay = RecordReplay(record, trust)
    labs = replay.laboratories
    spectra = {
        agent: channel_slices(bench.channels)["spectrum"]
        for agent, bench in zip(labs.bench_agents, labs.benches, strict=True)
        if any(channel.name == "spectrum" for channel in bench.channels) and "spectrum" not in blank_channels(bench)
    }
    running: dict[str, tuple[int, FloatArray, str]] = {}
    reactions = []

    def end(agent: str, observation: Any, contents: FloatArray, score: float | None) -> None:
        tick, before, goal = running.pop(agent)
        after = np.array(observation[spectra[agent]])
        reactions.append(_Reaction(agent, tick, goal, score, before, after, contents))

    for move in replay.moves():
        for play in move.plays:
            agent = labs.agents[play.agent]
            if agent in spectra and agent not in running:
                goal = labs.roles[play.agent].goal(0)
                running[agent] = (move.tick, np.array(play.observation[spectra[agent]]), goal)
        for agent, score in move.scores.items():
            if agent in running:
                slot = int(labs.state.origin[0, labs.bench_agents.index(agent)])
                end(agent, move.last[agent].observation, labs.shelf.amounts[0, slot].copy(), score)
    for agent in list(running):
        role = labs.bench_roles[labs.bench_agents.index(agent)]
        contents = labs.shelf.amounts[0, role.first_position].copy()
        end(agent, replay.look(role.index).observation, contents, None)
    return labs, reactions


def _peaks(labs: Laboratories, contents: FloatArray) -> list[tuple[float, str, str]]:
    """Return (wavelength in nm, material, colour) of the distinguishable peaks in ascending order.

    At a peak, the material has to contribute half of the total absorption, and at its highest peak a quarter.
    """
    basis = labs.shelf.known().basis * contents[:, None]
    total = basis.sum(axis=0)
    peaks = []
    for m, name in enumerate(labs.shelf.layout.materials):
        material: Material = labs.scenario.materials[name]
        if basis[m].max() <= 0.0:
            continue
        highest = max(peak.height_l_mol for peak in material.absorption)
        for peak in material.absorption:
            at = int(np.abs(WAVELENGTHS_NM - peak.center_nm).argmin())
            share = float(basis[m, at] / total[at])
            main = peak.height_l_mol == highest
            if share >= (0.25 if main else 0.5) and basis[m, at] >= (0.01 if main else 0.05) * total.max():
                peaks.append((peak.center_nm, name, material.color))
    return sorted(peaks)


def draw_spectra(record: Record, trust: bool = False) -> Any:
    """Draw the vessel's spectrum before and after each reaction experiment, with labelled peaks.

    Arguments and errors are those of :func:`draw_timeline`; RecordError also without a reaction experiment.
    """
    labs, reactions = _reactions(record, trust)
    if not reactions:
        raise RecordError(f"{record.path}: has no reaction experiment whose spectrum is observed")
    columns = 1 if len(reactions) == 1 else 2
    rows = -(-len(reactions) // columns)
    width, height = (8.0 if columns == 1 else 13.0), 0.5 + 3.5 * rows
    figure = new_figure(width, height)
    cell = (width - 0.15) / columns
    for i, reaction in enumerate(reactions):
        left, top = 0.65 + (i % columns) * cell, 0.5 + (i // columns) * 3.5
        axes = figure.add_axes((left / width, 1.0 - (top + 2.85) / height, (cell - 0.85) / width, 1.75 / height))
        _spectrum(axes, labs, reaction)
    figure.suptitle(f"{_title(record, labs.scenario)}: spectra of reaction experiments", y=1.0 - 0.12 / height)
    return figure


def _spectrum(axes: Any, labs: Laboratories, reaction: _Reaction) -> None:
    axes.plot(WAVELENGTHS_NM, reaction.before, color=_LINES[1], lw=1.6, ls="--", label="before")
    axes.fill_between(WAVELENGTHS_NM, reaction.after, color=_LINES[0], alpha=0.12, linewidth=0.0)
    axes.plot(WAVELENGTHS_NM, reaction.after, color=_LINES[0], lw=1.8, label="after")
    peaks = _peaks(labs, reaction.contents)
    for (center, name, color), x in zip(peaks, spread([p[0] for p in peaks], 27.0, 206.0, 794.0), strict=True):
        height = float(np.interp(center, WAVELENGTHS_NM, reaction.after))
        axes.plot([center, center, x], [height, 1.06, 1.14], color=FAINT, lw=0.8, clip_on=False)
        axes.plot([center], [height], marker="o", ms=6, color=color, mec=INK, mew=0.8, clip_on=False, zorder=5)
        axes.text(x, 1.16, name, rotation=40, ha="left", va="bottom", rotation_mode="anchor", fontsize=8, color=INK)
    axes.set_xlim(WAVELENGTHS_NM[0], WAVELENGTHS_NM[-1])
    axes.set_ylim(0.0, 1.04)
    axes.set_xlabel("wavelength (nm)")
    axes.set_ylabel("absorption")
    axes.grid(alpha=0.25)
    _plain(axes)
    axes.legend(loc="upper right", edgecolor="none", framealpha=1.0)
    end = "still running" if reaction.score is None else f"score {reaction.score:+.3f}"
    words = f"{reaction.agent} from tick {reaction.tick}, goal {reaction.goal}: {end}"
    axes.text(0.0, -0.36, words, transform=axes.transAxes, fontsize=9, color=SOFT)


_PLACE_WORDS = {
    "submitted": "submitted",
    "vessels": "in vessels",
    "stock": "in stock",
    "samples": "in samples",
    "discarded": "discarded",
    "lost": "spilled or vented",
}
_HATCHES = {"submitted": "", "vessels": "", "stock": "....", "samples": "xxxx", "discarded": "////", "lost": "xxxx"}
_MOST_STAGES = 7
_SMALL = 0.012
"""Materials whose share is below this are merged into one band, ``others``."""


def draw_moles(record: Record, trust: bool = False, only: Sequence[str] = ()) -> Any:
    """Draw the mole balance: one panel for each element that reacted and each material that was only moved.

    Args:
        record, trust: as for :func:`draw_timeline`, whose errors it raises as well.
        only: Names of elements and materials to draw. Default: all, without hydrogen if there is carbon.

    Raises:
        ValueError: the amounts do not balance, or a name is unknown.
    """
    balance = mole_balance(record, trust)
    groups = _chosen(balance, only)
    columns = 1 if len(groups) == 1 else 2
    rows = -(-len(groups) // columns)
    width, height = 8.2 * columns, 0.95 + 3.3 * rows
    figure = new_figure(width, height)
    scenario = recorded_scenario(record)
    for i, group in enumerate(groups):
        left, top = 8.2 * (i % columns), 0.95 + 3.3 * (i // columns)
        axes = figure.add_axes(((left + 1.95) / width, 1.0 - (top + 2.75) / height, 4.1 / width, 2.4 / height))
        _alluvium(axes, balance, group, scenario)
    figure.suptitle(f"{_title(record, scenario)}: mole balance", y=1.0 - 0.12 / height)
    figure.text(0.5, 1.0 - 0.55 / height, "Every column has the same total. Colour: material; "
                "dots: in stock; strokes: discarded; crosses: in samples, spilled or vented; bold frame: submitted.",
                ha="center", fontsize=9, color=SOFT)  # fmt: skip
    return figure


def _chosen(balance: Balance, only: Sequence[str]) -> list[Group]:
    names = [group.name for group in balance.groups]
    unknown = [name for name in only if name not in names]
    if unknown:
        raise ValueError(f"only: {', '.join(unknown)} is not in this record; choose from {', '.join(names)}")
    if only:
        return [group for group in balance.groups if group.name in only]
    return [group for group in balance.groups if not (group.element and group.name == "H" and "C" in names)]


def _dark(color: str) -> bool:
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return 0.3 * red + 0.6 * green + 0.1 * blue < 110.0


def _alluvium(axes: Any, balance: Balance, group: Group, scenario: Scenario) -> None:
    """Draw columns of (place, material) bands and the flows between consecutive stages."""
    amounts = balance.amounts(group)
    total = float(amounts[0].sum())
    chosen = np.unique(np.linspace(0, len(amounts) - 1, min(len(amounts), _MOST_STAGES)).round().astype(int))
    shares = amounts[chosen] / total
    large = [(p, m) for p, m in np.argwhere(shares.max(axis=0) > 0.0).tolist() if shares[:, p, m].max() >= _SMALL]
    bands = [(PLACES[p], balance.materials[m], shares[:, p, m]) for p, m in large]
    rest = 1.0 - sum((share for _, _, share in bands), np.zeros(len(chosen)))
    if rest.max() > 1e-9:
        bands.append(("", "others", np.maximum(rest, 0.0)))
    tops = np.cumsum([share for _, _, share in bands], axis=0)
    lows = tops - [share for _, _, share in bands]
    half, fine = 0.17, np.linspace(0.0, 1.0, 30)
    smooth = fine**2 * (3.0 - 2.0 * fine)
    for (place, material, _), low, top in zip(bands, lows, tops, strict=True):
        color = scenario.materials[material].color if place else "#ffffff"
        hatch = _HATCHES.get(place, "")
        stroke = "#ffffff" if _dark(color) else SOFT
        for c in range(len(chosen)):
            if top[c] - low[c] > 1e-6:
                axes.bar(c, top[c] - low[c], 2 * half, bottom=low[c], color=color, hatch=hatch,
                         edgecolor=INK if place == "submitted" else stroke,
                         linewidth=1.8 if place == "submitted" else 0.6,
                         zorder=4 if place == "submitted" else 3)  # fmt: skip
            if c + 1 < len(chosen):
                x = c + half + fine * (1.0 - 2.0 * half)
                under = low[c] + (low[c + 1] - low[c]) * smooth
                over = top[c] + (top[c + 1] - top[c]) * smooth
                axes.fill_between(x, under, over, color=color, alpha=0.4, linewidth=0.0, zorder=1)
    for column, side in ((0, -1.0), (-1, 1.0)):
        edge = -half - 0.08 if column == 0 else len(chosen) - 1 + half + 0.08
        named = [
            (f"{material} {_PLACE_WORDS[place]}" if place else material, low[column], top[column])
            for (place, material, _), low, top in zip(bands, lows, tops, strict=True)
            if top[column] - low[column] >= _SMALL / 2
        ]
        heights = spread([0.5 * (low + top) for _, low, top in named], 0.085, 0.0, 1.0)
        for (what, low, top), y in zip(named, heights, strict=True):
            align = "right" if side < 0.0 else "left"
            axes.text(edge + 0.1 * side, y, f"{what} {top - low:.0%}", ha=align, va="center", fontsize=8, color=INK)
            axes.plot([edge, edge + 0.08 * side], [0.5 * (low + top), y], color=FAINT, lw=0.7, clip_on=False)
    inventories = [balance.inventories[c] for c in chosen]
    axes.set_xticks(range(len(chosen)), [f"{at.label}\ntick {at.tick}" for at in inventories], fontsize=7.5)
    axes.set_xlim(-half - 0.05, len(chosen) - 1 + half + 0.05)
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([])
    axes.tick_params(axis="x", length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    what = f"{group.name} in all materials that react" if group.element else group.name
    axes.set_title(f"{what}: {total:.4g} mol", fontsize=10.5, pad=7)
