"""A record as a protocol in Markdown: vessels, actions of every agent, added materials, readings, and the result."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from ..config.display import inert
from ..config.scenario import Scenario
from ..lab.describe import amount_words
from ..lab.engine import Laboratories
from ..lab.text import action_words, reading_words
from ..physics.chemistry import TEMPERATURE
from ..record import Record
from ..roles.manager_state import COST_WORDS
from .history import Move, RecordReplay

_TRACE_MOL = 1e-9


@dataclass
class _Step:
    """Consecutive equal actions of one agent."""

    tick: int
    agent: str
    words: str
    times: int = 0
    added: Counter[str] = field(default_factory=Counter)
    after: str = ""

    def line(self) -> str:
        times = f" ({self.times} times)" if self.times > 1 else ""
        added = f" Added: {amount_words(self.added)}." if self.added else ""
        return f"- tick {self.tick}, {self.agent}: {self.words}{times}.{added}{self.after}"


def protocol(record: Record, trust: bool = False, scenario: Scenario | None = None) -> str:
    """Return the procedure of an episode as Markdown.

    Args:
        record: a record, finished or not.
        trust: allow imports of code that the record names.
        scenario: custom parts are looked for in the folder of its file; None: in the record's folder.

    Raises:
        RecordError: the record cannot be replayed here.
    """
    replay = RecordReplay(record, trust, beside=scenario)
    labs = replay.laboratories
    spec, steps, latest = labs.scenario, list[_Step](), dict[str, _Step]()
    summary = spec.summary if spec.summary.endswith((".", "!", "?")) or not spec.summary else f"{spec.summary}."
    lines = [f"# {spec.title}", "", f"{summary} Simulated by chemlab {record.header.get('chemlab')}: scenario"]
    lines[-1] += f" `{spec.name}`, seed {record.header.get('seed')}."
    lines += ["", "## Vessels at the beginning", ""]
    for slot in range(spec.shelf.slots):
        held = {name: mol for name, mol in labs.shelf.vessel(0, slot).amounts(-1.0).items() if mol > _TRACE_MOL}
        lines += [f"- slot {slot}: {amount_words(held)}"] if held else []
    stock = labs.shelf.stock[0].copy()
    for move in replay.moves():
        for play in move.plays:
            agent, words = labs.agents[play.agent], action_words(labs, play.agent, play.action)
            step = latest.get(agent)
            if step is None or step.words != words or move.manager:
                step = latest[agent] = _Step(move.tick, agent, words)
                steps.append(step)
            step.times += 1
            step.after = _after(labs, move, agent)
        used, stock = stock - labs.shelf.stock[0], labs.shelf.stock[0].copy()
        if used.max() > _TRACE_MOL:
            step = latest[labs.agents[move.plays[0].agent]]
            if len(move.plays) > 1:  # in a round, the stock does not show which agent used a material
                step = _Step(move.tick, "benches", "all have acted", 1)
                steps.append(step)
            for i in np.flatnonzero(used > _TRACE_MOL).tolist():
                step.added[labs.shelf.layout.materials[i]] += used[i].item()
        for agent in move.scores:  # the next experiment has steps of its own
            latest.pop(agent, None)
    lines += ["", "## Procedure", "", *(step.line() for step in steps), "", "## Result", ""]
    lines += [f"- score {float(labs.result(labs.members)[0]):.4f}, after {int(labs.state.ticks[0])} ticks"]
    costs = zip(COST_WORDS, labs.costs().values(), strict=True)
    lines += [f"- cost of {item}: {cost:.4g}" for item, cost in costs if cost]
    return "\n".join(map(inert, lines)) + "\n"


def _after(labs: Laboratories, move: Move, agent: str) -> str:
    """Describe the consequence of an action: a reading, a score, or the state of the vessel at the bench."""
    if agent in move.lost:
        return " Invalid: it had no effect."
    if move.manager and move.manager[0] == "measure":
        _, slot, instrument = move.manager
        return f" Read: {reading_words(labs, int(slot), str(instrument))}."
    ended = move.scores.values() if move.manager else [move.scores[agent]] if agent in move.scores else []
    if ended:
        return f" The experiment is over: bench score {', '.join(f'{score:+.3f}' for score in ended)}."
    if move.manager or agent not in labs.bench_agents:
        return ""
    vessel = labs.shelf.vessel(0, labs.bench_roles[labs.bench_agents.index(agent)].first_position)
    return f" Then {float(vessel.row[TEMPERATURE]):.1f} K, {vessel.volume_l:.3f} L."
