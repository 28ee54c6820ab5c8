"""Episodes as data: written turn by turn while they are played, read back, and proved by playing them again.

| Line of the file | Holds |
|---|---|
| first | format, versions, the whole scenario and its hash, seed, options, random streams, goals, policies |
| one a turn | who played what on which observation (a hash), rewards, costs, readings; `hidden`: what no agent sees |
| last | the result: score, goals, amounts and purities, rewards, costs, safety events |

A record is UTF-8 text, one JSON object a line, every number as exact as the simulator had it. The same episode gives
the same bytes. While an episode is being played its record is `FILE.part`; each line is there as soon as its turn is
over, so after a crash everything up to the last whole line can be read. A whole record is `FILE`.

### Keys of a turn
`turn` counts from 0; `tick` is the laboratory's before the turn; `play` maps each agent that acted to
`[hash of observation and mask, action]`; `rewards` and `cost` have the agents' numbers that are not 0; `lost` names
agents whose action was not possible; `events` the safety events; `scores` the experiments that ended; `reading` what
the manager has measured (`slot`, `instrument`, `values` as the manager sees them, from 0 to 1).
`hidden.vessels` has the vessels that changed, by position: `[temperature in K, mol of each of the header's materials]`,
or null where no vessel stands any more; `hidden.stock` and `hidden.waste` likewise [mol of each material] when they
changed; `hidden.state` is a hash of everything the rest of the episode depends on.

### What a record proves
Every line ends with a hash of itself and of the line before, so a line that was edited, removed, added or moved by
accident or by hand is noticed. Anybody can compute such hashes again, though. What proves a result is that
:func:`verify_record` plays the recorded actions on the simulator and gets the same numbers, to the last bit.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Literal, NamedTuple, get_args

import llvmlite
import numba
import numpy as np
import numpy.typing as npt

from . import __version__
from .arrays import IntArray, MaskArray, ObservationArray
from .bench.base import BENCH_KINDS
from .bench.models import ReactionModel, SeparationModel
from .chemistry import AMOUNTS, PRESENT, TEMPERATURE
from .laboratory.actions import MEASURE
from .laboratory.core import Laboratories
from .laboratory.state import RUNNING
from .materials import DataError
from .scenario import SAFETY_EVENTS, Scenario, dump_scenario, load_scenario, restore_scenario, scenario_names

__all__ = [
    "EXIT_CODES",
    "FORMAT",
    "Play",
    "Record",
    "RecordError",
    "Recorder",
    "Replay",
    "Status",
    "Verification",
    "read_record",
    "recorded_scenario",
    "scenario_hash",
    "seen_hash",
    "verify_record",
]

FORMAT = {"name": "chemlab-episode", "version": 1}
"""What the first line of every record begins with; the version counts up when a reader would have to change."""

_HASH_BYTES = 8
_ROUNDING = 1e-6
"""Relative difference that another processor or compiler may leave in a number by the end of an episode."""

Status = Literal["ok", "tampered", "torn", "other", "unchecked"]
EXIT_CODES: dict[Status, int] = {"ok": 0, "tampered": 1, "torn": 3, "other": 4, "unchecked": 5}
"""What ``chemlab verify`` ends with; 2 is a mistake on the command line."""


class RecordError(ValueError):
    """A file is no record, or cannot be played again here; the message says why."""


def _digest(*parts: bytes) -> str:
    digest = hashlib.blake2b(digest_size=_HASH_BYTES)
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def _text(value: Any) -> str:
    """Compact JSON; floats as the shortest text that reads back as the same number."""
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)


def scenario_hash(scenario: Scenario) -> str:
    """Hash of everything a scenario says, with its materials and reactions."""
    return _digest(_text(dump_scenario(scenario)).encode())


def seen_hash(observation: ObservationArray, mask: MaskArray | None) -> str:
    """Hash of what an agent was shown: its observation and, where it has one, its mask."""
    shown = np.ascontiguousarray(observation, dtype="<f4").tobytes()
    return _digest(shown, b"" if mask is None else np.ascontiguousarray(mask, dtype=np.int8).tobytes())


class Play(NamedTuple):
    """What one agent was shown and did."""

    agent: int
    """Number of the agent (0 is the manager)."""
    observation: ObservationArray
    mask: MaskArray | None
    action: Any


# -- telling what happens -------------------------------------------------------------------------------------


class _Witness:
    """Says what happens in one laboratory as the lines of a record; made right after the laboratory's reset.

    Recording and verifying are both this: what is written, and what it is compared with.
    """

    def __init__(self, laboratories: Laboratories, member: int) -> None:
        self._labs, self._m = laboratories, member
        self._member: IntArray = laboratories.members[member : member + 1]
        count = len(laboratories.shelf.layout.materials)
        self._amounts = slice(AMOUNTS, AMOUNTS + count)
        self._vessels = np.zeros_like(laboratories.shelf.vessels[member])
        self._bulk = {"stock": np.zeros(count), "waste": np.zeros(count)}
        self.rewards = dict.fromkeys(laboratories.agents, 0.0)
        self.turns = 0

    def _streams(self) -> dict[str, int]:
        labs = self._labs
        streams = [labs.desk.stream, *(station.stream for station in labs.stations)]
        return {agent: int(stream[self._m, 0]) for agent, stream in zip(labs.agents, streams, strict=True)}

    def opening(self) -> dict[str, Any]:
        """What the episode begins with."""
        labs = self._labs
        positions = [f"slot_{s}" for s in range(labs.scenario.shelf.slots)]
        for agent, bench in zip(labs.bench_agents, labs.benches, strict=True):
            positions += [f"{agent}.{position}" for position in bench.positions]
        return {
            "agents": labs.agents,
            "goals": [labs.scenario.goals[goal] for goal in labs.desk.goal[self._m].tolist()],
            "streams": self._streams(),
            "materials": list(labs.shelf.layout.materials),
            "positions": positions,
            "hidden": self._hidden(),
        }

    def turn(self, tick: int, plays: Sequence[Play]) -> dict[str, Any]:
        """What a turn (or a round of several agents) led to, right after it."""
        labs, m = self._labs, self._m
        line: dict[str, Any] = {"turn": self.turns, "tick": tick, "play": {}}
        lost, events = [], {}
        for play in plays:
            agent = labs.agents[play.agent]
            action = np.asarray(play.action)
            # Of the action as the simulator takes it: a policy's float32 is what it is as float64.
            recorded = action.astype(np.float64).tolist() if action.dtype.kind == "f" else action.tolist()
            line["play"][agent] = [seen_hash(play.observation, play.mask), recorded]
            info = labs.info(play.agent, m)
            if info["illegal_action"]:
                lost.append(agent)
            if info["events"]:
                events[agent] = info["events"]
        for key, values in (("rewards", labs.rewards[m]), ("cost", labs.cost[m])):
            found = {agent: value for agent, value in zip(labs.agents, values.tolist(), strict=True) if value}
            if found:
                line[key] = found
        for agent, reward in line.get("rewards", {}).items():
            self.rewards[agent] += reward
        if lost:
            line["lost"] = lost
        if events:
            line["events"] = events
        ended = {agent: s for agent, s in zip(labs.agents, labs.scores[m].tolist(), strict=True) if s == s}
        if ended:
            line["scores"] = ended
        if plays[0].agent == 0 and not lost:
            kind, slot, instrument, _ = labs.actions.table[int(plays[0].action)].tolist()
            if kind == MEASURE:
                start, stop = labs.instruments.start[instrument : instrument + 2]
                values = labs.desk.reading[m, slot, start:stop].tolist()
                line["reading"] = {"slot": slot, "instrument": labs.instruments.names[instrument], "values": values}
        line["hidden"] = self._hidden()
        self.turns += 1
        return line

    def _hidden(self) -> dict[str, Any]:
        """What has changed of what no agent sees."""
        labs, m = self._labs, self._m
        vessels: dict[str, Any] = {}
        now = labs.shelf.vessels[m]
        for position in np.flatnonzero((now != self._vessels).any(axis=1)):
            row = now[position]
            was = self._vessels[position]
            if not row[PRESENT]:
                vessels[str(position)] = None
            elif (
                row[TEMPERATURE] != was[TEMPERATURE]
                or row[PRESENT] != was[PRESENT]
                or (row[self._amounts] != was[self._amounts]).any()
            ):
                vessels[str(position)] = [row[TEMPERATURE].item(), [x or 0 for x in row[self._amounts].tolist()]]
            was[:] = row
        hidden: dict[str, Any] = {"vessels": vessels} if vessels else {}
        for key, values in (("stock", labs.shelf.stock[m]), ("waste", labs.shelf.waste[m])):
            if (values != self._bulk[key]).any():
                hidden[key] = [x or 0 for x in values.tolist()]
                self._bulk[key][:] = values
        hidden["state"] = self._state()
        return hidden

    def _state(self) -> str:
        labs, m = self._labs, self._m
        arrays = [labs.shelf.vessels[m], labs.shelf.stock[m], labs.shelf.waste[m]]
        # Readings are the largest part and in the record anyway, from when they were taken.
        arrays += labs.state.member(m, without="reading")
        for station in labs.stations:
            arrays.append(station.stream[m])
            if station.busy[m]:  # an idle bench's other numbers are left over from experiments before
                arrays += [station.goal[m], station.steps[m], station.supply[m]]
        return _digest(b"".join([array.tobytes() for array in arrays]))

    @property
    def over(self) -> bool:
        """Whether the episode is over."""
        return bool(self._labs.desk.status[self._m] != RUNNING)

    def closing(self) -> dict[str, Any]:
        """What the episode came to."""
        labs, m = self._labs, self._m
        totals = zip(SAFETY_EVENTS, labs.safety_totals[m].tolist(), strict=True)
        result = {
            "status": ("running", "submitted", "truncated")[int(labs.desk.status[m])],
            "score": labs.result(self._member).item(),
            **labs.outcome(m),
            "rewards": self.rewards,
            "costs": labs.costs(m),
            "safety_events": {kind: value for kind, value in totals if value},
            "manager_actions": int(labs.desk.actions[m]),
            "ticks": int(labs.desk.ticks[m]),
            "turns": self.turns,
        }
        return {"end": result}


def _environment() -> dict[str, str]:
    """What numbers could depend on besides chemlab; for information."""
    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "llvm": ".".join(map(str, llvmlite.binding.llvm_version_info)),
        "platform": sys.platform,
        "machine": platform.machine(),
        "processor": llvmlite.binding.get_host_cpu_name(),
    }


def _models(laboratories: Laboratories) -> dict[str, str]:
    """Physics of the user's own that replaces chemlab's, by name."""
    found = {}
    for bench in laboratories.benches:
        for key in ("reaction_model", "separation_model"):
            model = getattr(bench, key, None)
            if model is not None:
                kind = model if hasattr(model, "__qualname__") else type(model)
                found[key] = f"{kind.__module__}:{kind.__qualname__}"
    return found


class Recorder:
    """Writes the episodes of one laboratory to a file each.

    Use it as a context manager, or call :meth:`close`. ``begin`` comes after the laboratory's reset, ``turn`` after
    every turn; the record is finished by the turn that ends the episode. One that is left before that stays
    ``FILE.part``, readable as far as it goes.

    Args:
        path: the record; nothing may be there, unless ``force``.
        laboratories: where the episode is played.
        member: which of them.
        policies: names of who plays each agent, for information.
        rounds: turns are rounds, in which all busy benches act on what they saw when the tick began (parallel API).
        force: replace what is at ``path``.

    Raises:
        ValueError: ``path`` is there already.
    """

    def __init__(
        self,
        path: str | Path,
        laboratories: Laboratories,
        member: int = 0,
        policies: Mapping[str, str] | None = None,
        rounds: bool = False,
        force: bool = False,
    ) -> None:
        self.path = Path(path)
        self.part = self.path.with_name(self.path.name + ".part")
        self._labs, self._member = laboratories, member
        self._policies, self._rounds, self._force = dict(policies or {}), rounds, force
        self._file: BinaryIO | None = None
        self._witness: _Witness | None = None
        self._chain = ""
        self._tick = 0
        for there in () if force else (self.path, self.part):
            if there.exists():
                raise ValueError(f"{there}: is already there; give another name, or --force to replace it")

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def begin(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Begin the record of an episode; the laboratory has just been reset.

        Args:
            seed: what it was seeded with; None where its random streams went on, which the record then begins with.
            options: those of the reset.
        """
        if self._file is not None:
            raise ValueError(f"{self.path}: its episode is not over; a record holds one episode")
        labs = self._labs
        data = dump_scenario(labs.scenario)
        goal = (options or {}).get("goal")
        self._witness = _Witness(labs, self._member)
        self.part.parent.mkdir(parents=True, exist_ok=True)
        self._file = self.part.open("wb" if self._force else "xb")
        self._chain, self._tick = "", 0
        self._write(
            {
                "format": FORMAT,
                "chemlab": __version__,
                "scenario_hash": _digest(_text(data).encode()),
                "seed": seed,
                "options": {} if goal is None else {"goal": goal},
                "rounds": self._rounds,
                "policies": self._policies,
                "models": _models(labs),
                "environment": _environment(),
                **self._witness.opening(),
                "scenario": data,
            }
        )

    def turn(self, plays: Sequence[Play]) -> None:
        """Write a turn that has just been played (a round, where the recorder is one of rounds).

        Args:
            plays: who acted, in the agents' order.
        """
        if self._witness is None or self._file is None:
            raise ValueError(f"{self.path}: begin() comes first, and nothing after the end of the episode")
        self._write(self._witness.turn(self._tick, plays))
        self._tick = int(self._labs.desk.ticks[self._member])
        if self._witness.over:
            self._write(self._witness.closing())
            os.fsync(self._file.fileno())
            self.close()
            if self.path.exists() and not self._force:
                raise ValueError(f"{self.path}: somebody else has put a file there; the record is {self.part}")
            self.part.replace(self.path)

    def _write(self, line: dict[str, Any]) -> None:
        assert self._file is not None
        text, self._chain = _chained(line, self._chain)
        self._file.write(text)
        self._file.flush()

    def close(self) -> None:
        """Close the file; the record of an unfinished episode stays ``FILE.part``."""
        if self._file is not None:
            self._file.close()
            self._file = None


def _chained(line: dict[str, Any], before: str) -> tuple[bytes, str]:
    """A line as bytes, and its hash."""
    body = _text(line)[:-1].encode()
    chain = _digest(before.encode(), body)
    return body + _CHAIN + chain.encode() + b'"}\n', chain


_CHAIN = b',"chain":"'


# -- reading --------------------------------------------------------------------------------------------------


@dataclass
class Record:
    """A record as it was found.

    Attributes:
        header: the first line.
        turns: one a turn.
        end: the result, or None where the file ends before it.
        broken: (number of the first line that is not what was written, what is the matter), or None.
    """

    path: Path
    header: dict[str, Any]
    turns: list[dict[str, Any]] = field(default_factory=list)
    end: dict[str, Any] | None = None
    broken: tuple[int, str] | None = None

    @property
    def torn(self) -> bool:
        """Whether the end is missing: the episode was not over, or the file has been cut."""
        return self.end is None


def read_record(path: str | Path) -> Record:
    """Read a record, or as much of one as there is.

    Raises:
        RecordError: there is no such file, or it is no record of this format.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        part = path.with_name(path.name + ".part")
        hint = f"; the episode was not finished: read {part}" if part.is_file() else ""
        raise RecordError(f"{path}: {error.strerror or error}{hint}") from error
    lines = content.split(b"\n")
    whole, tail = lines[:-1], lines[-1]
    record: Record | None = None
    chain, broken = "", None
    for number, text in enumerate(whole, start=1):
        line, found = _parse(text)
        if record is None:
            record = Record(path, _checked_header(path, line))
        elif line is None:  # not torn: a line's end is written with it
            broken = broken or (number, "cannot be read")
            continue
        elif record.end is not None:
            broken = broken or (number, "stands after the end of the episode")
            break
        elif "end" in line:
            record.end = line
        else:
            record.turns.append(line)
        expected = _digest(chain.encode(), text[: -len(_CHAIN) - 2 * _HASH_BYTES - 2])
        if found != expected:
            broken = broken or (number, "is not the line that was written here (its hash differs)")
        chain = found
    if record is None:
        _checked_header(path, None)
    assert record is not None
    if record.end is not None and tail:
        broken = broken or (len(whole) + 1, "stands after the end of the episode")
    record.broken = broken
    return record


def _parse(text: bytes) -> tuple[dict[str, Any] | None, str]:
    """(the line without its hash, the hash), or None where it is no line of a record."""
    try:
        line = json.loads(text)
    except (ValueError, RecursionError):
        return None, ""
    if not isinstance(line, dict):
        return None, ""
    chain = line.pop("chain", "")
    return line, chain if isinstance(chain, str) else ""


def _checked_header(path: Path, header: dict[str, Any] | None) -> dict[str, Any]:
    form = header.get("format") if header else None
    if header is None or not isinstance(form, dict) or form.get("name") != FORMAT["name"]:
        raise RecordError(f"{path}: is not a record of an episode (its first line is not the header of one)")
    return header


# -- playing again --------------------------------------------------------------------------------------------


class Replay:
    """A record's episode on the simulator again, turn by turn.

    Args:
        record: the record.
        trust: import benches that the record's scenario names (``module:Class``); without it that is an error,
            because a file from elsewhere should not decide what Python runs.
        reaction_model, separation_model: the user's own physics, where the record was made with such.

    Attributes:
        laboratories: as it stands after the turns played so far.

    Raises:
        RecordError: the episode cannot be played here; the message says what is missing.
    """

    def __init__(
        self,
        record: Record,
        trust: bool = False,
        reaction_model: ReactionModel | None = None,
        separation_model: SeparationModel | None = None,
    ) -> None:
        header = record.header
        self.record = record
        scenario = recorded_scenario(record)
        own = [bench.kind for bench in scenario.benches.values() if bench.kind not in BENCH_KINDS]
        if own and not trust:
            raise RecordError(f"needs {own[0]}, which is imported only if you say that you trust it")
        given = {"reaction_model": reaction_model, "separation_model": separation_model}
        for key, name in dict(header.get("models") or {}).items():
            if given.get(key) is None:
                raise RecordError(f"was made with {key} {name}: give it to verify_record()")
        try:
            self.laboratories = Laboratories(scenario, 1, reaction_model, separation_model)
        except DataError as error:
            raise RecordError(str(error)) from error
        self.rounds = header.get("rounds") is True
        self._reset(header)

    def _reset(self, header: dict[str, Any]) -> None:
        labs = self.laboratories
        seed, goal = header.get("seed"), (header.get("options") or {}).get("goal")
        labs.seed(0, 0 if seed is None else seed)
        labs.reset(labs.members, goal)
        if seed is None:  # the streams went on from an episode before: the record begins with what they were
            streams = [labs.desk.stream, *(station.stream for station in labs.stations)]
            for agent, stream in zip(labs.agents, streams, strict=True):
                stream[0, 0] = header["streams"][agent]
            labs.desk.goal[0] = [labs.goal_index(name) for name in header["goals"]]

    def play(self, turn: Mapping[str, Any]) -> list[Play]:
        """Play one recorded turn; returns what each agent was shown and did.

        Raises:
            ValueError: such a turn is not possible: somebody else has the turn, or there is no such action.
        """
        labs, recorded = self.laboratories, turn.get("play")
        if not isinstance(recorded, dict):
            raise ValueError("play: says nothing of who played what")
        if labs.desk.status[0] != RUNNING:
            raise ValueError("play: the episode is over")
        numbers = np.flatnonzero(labs.turns(labs.members)[:, 0]).tolist() if self.rounds else [labs.turn()]
        having = [labs.agents[number] for number in numbers]
        if list(recorded) != having:
            raise ValueError(f"play: {', '.join(having)} had the turn, not {', '.join(map(str, recorded)) or 'nobody'}")
        plays, actions = [], []
        for number, agent in zip(numbers, having, strict=True):
            entry = recorded[agent]
            if not isinstance(entry, list) or len(entry) != 2:
                raise ValueError(f"play.{agent}: must be an observation's hash and an action, given {entry!r}")
            action = labs.checked(number, np.array(entry[1]) if isinstance(entry[1], list) else entry[1])
            mask = labs.mask(number, labs.members)
            seen = labs.observe(number, labs.members)[0]
            plays.append(Play(number, seen, None if mask is None else mask[0], action[0]))
            actions.append(action)
        if self.rounds:
            everybody: list[npt.NDArray[Any]] = [np.zeros(0)] * len(labs.agents)
            for number, action in zip(numbers, actions, strict=True):
                everybody[number] = action
            labs.act_round(labs.members, everybody)
        else:
            labs.act(numbers[0], labs.members, actions[0])
        return plays


def recorded_scenario(record: Record) -> Scenario:
    """The scenario a record was made on, from the record alone.

    Raises:
        RecordError: it is of another format, or what it says is no scenario.
    """
    form = record.header["format"]
    if form != FORMAT:
        raise RecordError(f"is of format {form.get('version')!r}; this chemlab reads format {FORMAT['version']}")
    try:
        return restore_scenario(record.header["scenario"], f"{record.path}: scenario")
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise RecordError(f"holds no scenario: {error}") from error


# -- verifying ------------------------------------------------------------------------------------------------


@dataclass
class Verification:
    """What came of playing a record again.

    Attributes:
        status: ``ok``; ``tampered`` (something in it is not what happens); ``torn`` (the end is missing, the rest is
            right); ``other`` (right or not, it is of another version, scenario or platform, see ``message``);
            ``unchecked`` (no record, or it cannot be played here).
        message: the finding in words.
        turns: number of turns that were played again and found right.
        turn: the first turn that is not, None where there is none or it is the first or the last line.
        where: the first line that differs: ``header``, ``turn 12``, ``end``.
        key: what differs there.
        recorded, recomputed: its two values.
        notes: what else is worth knowing.
    """

    path: str
    status: Status
    message: str
    turns: int = 0
    turn: int | None = None
    where: str = ""
    key: str = ""
    recorded: Any = None
    recomputed: Any = None
    score: float | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def exit_code(self) -> int:
        """What ``chemlab verify`` ends with."""
        return EXIT_CODES[self.status]

    def as_dict(self) -> dict[str, Any]:
        """The fields as plain Python values."""
        return dict(vars(self))


class _Absent:
    """Stands for a key that is not there."""

    def __repr__(self) -> str:
        return "nothing"


_ABSENT = _Absent()


def _differences(recorded: Any, recomputed: Any, key: str = "") -> Iterable[tuple[str, Any, Any]]:
    """(key, recorded, recomputed) of everything that differs, in the order of the recomputed line."""
    if isinstance(recorded, dict) and isinstance(recomputed, dict):
        for name in [*recomputed, *(name for name in recorded if name not in recomputed)]:
            inner = f"{key}.{name}" if key else str(name)
            yield from _differences(recorded.get(name, _ABSENT), recomputed.get(name, _ABSENT), inner)
    elif isinstance(recorded, list) and isinstance(recomputed, list) and len(recorded) == len(recomputed):
        for i, (one, other) in enumerate(zip(recorded, recomputed, strict=True)):
            yield from _differences(one, other, f"{key}.{i}")
    elif isinstance(recorded, bool) is not isinstance(recomputed, bool) or recorded != recomputed:
        yield key, recorded, recomputed


def _rounding(key: str, recorded: Any, recomputed: Any) -> bool:
    """Whether a difference is one that another platform may make: a hash, or the last digits of a number."""
    if isinstance(recorded, float) and isinstance(recomputed, (int, float)):
        return abs(recorded - recomputed) <= _ROUNDING * max(abs(recorded), abs(recomputed), 1.0)
    return isinstance(recorded, str) and (key.startswith("play.") or key == "hidden.state")


def _plain(value: Any) -> Any:
    return None if value is _ABSENT else value


class _Check:
    """Plays a record again and keeps the first difference."""

    def __init__(self, record: Record, replay: Replay) -> None:
        self.record, self.replay = record, replay
        self.environment = _environment()
        self.elsewhere = record.header.get("environment") != self.environment
        # Another version keeps its state otherwise; what can be asked is whether it comes to the same results.
        self.same_version = record.header.get("chemlab") == __version__
        self.rounded = 0
        self.good = 0
        self.found: tuple[str, str, Any, Any] | None = None

    def compare(self, where: str, recorded: Mapping[str, Any], recomputed: Mapping[str, Any]) -> bool:
        """Whether a line is as it should be; keeps the first difference."""
        for key, one, other in _differences(dict(recorded), dict(recomputed)):
            if key == "hidden.state" and not self.same_version:
                continue
            if self.elsewhere and _rounding(key, one, other):
                self.rounded += 1
                continue
            self.found = (where, key, one, other)
            return False
        return True

    def run(self) -> None:
        """Play, until something differs."""
        record, replay = self.record, self.replay
        labs = replay.laboratories
        witness = _Witness(labs, 0)
        opening = witness.opening()
        if not self.compare("header", {key: record.header.get(key, _ABSENT) for key in opening}, opening):
            return
        for number, turn in enumerate(record.turns):
            where, tick = f"turn {number}", int(labs.desk.ticks[0])
            if witness.over:
                self.found = (where, "play", turn.get("play"), "nothing: the episode is over")
                return
            try:
                plays = replay.play(turn)
            except (ValueError, TypeError) as error:
                key, _, problem = str(error).partition(": ")
                self.found = (where, key if key.startswith("play") else "play", turn.get("play"), problem)
                return
            line = witness.turn(tick, plays)
            if not self.compare(where, turn, line):
                return
            self.good += 1
        if record.end is not None:
            self.compare("end", record.end, witness.closing())


def verify_record(
    path: str | Path | Record,
    scenario: str | Path | Scenario | None = None,
    trust: bool = False,
    reaction_model: ReactionModel | None = None,
    separation_model: SeparationModel | None = None,
) -> Verification:
    """Play a record's actions on the simulator and compare all it says with what happens.

    Args:
        path: the record.
        scenario: what it must have been made on; default: the shipped scenario of the same name, if there is one.
        trust: import benches of somebody's own that the record names.
        reaction_model, separation_model: the physics it was made with, where that was not chemlab's.
    """
    name = str(path.path if isinstance(path, Record) else path)
    try:
        record = path if isinstance(path, Record) else read_record(path)
    except RecordError as error:
        return Verification(name, "unchecked", str(error).removeprefix(f"{name}: "))
    header = record.header
    others = []
    if header["format"] != FORMAT:
        made = header["format"].get("version")
        return Verification(name, "other", f"format {made!r}; this chemlab checks format {FORMAT['version']}")
    if header.get("chemlab") != __version__:
        others.append(f"made by chemlab {header.get('chemlab')}, this is {__version__}")
    try:
        replay = Replay(record, trust, reaction_model, separation_model)
    except RecordError as error:
        status: Status = "other" if others else "unchecked"
        if record.broken is not None:
            status, others = "tampered", [_broken(record.broken), *others]
        return Verification(name, status, "; ".join([*others, str(error)]))
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        return Verification(name, "tampered", f"header: no episode can begin like this: {error}", where="header")
    spec = replay.laboratories.scenario
    actual = scenario_hash(spec)
    expected = _expected(scenario, spec)
    if expected is not None and scenario_hash(expected) != actual:
        others.append(f"scenario {spec.name} is not {expected.origin}")
    check = _Check(record, replay)
    check.run()
    return _verdict(record, check, others, actual)


def _expected(scenario: str | Path | Scenario | None, spec: Scenario) -> Scenario | None:
    if scenario is not None:
        return load_scenario(scenario)
    return load_scenario(spec.name) if spec.name in scenario_names() else None


def _verdict(record: Record, check: _Check, others: list[str], actual: str) -> Verification:
    """The findings as one result, the worst first."""
    result = Verification(str(record.path), "ok", "", turns=check.good)
    if record.end is not None and isinstance(record.end.get("end"), dict):
        result.score = record.end["end"].get("score")
    edited, problems = [], []
    if record.broken is not None:
        edited.append(_broken(record.broken))
    if record.header.get("scenario_hash") != actual:
        edited.append("header: scenario_hash is not the hash of its scenario")
    if check.found is not None:
        result.where, result.key, recorded, recomputed = check.found
        result.recorded, result.recomputed = _plain(recorded), _plain(recomputed)
        result.turn = int(result.where.split()[1]) if result.where.startswith("turn") else None
        problems.append(f"{result.where}: {result.key}: recorded {_short(recorded)}, recomputed {_short(recomputed)}")
    if edited or (problems and not others):
        result.status, result.message = "tampered", "; ".join([*edited, *others, *problems])
    elif others:
        agree = "; ".join(problems) or f"played on it, all {check.good} turns agree"
        result.status, result.message = "other", "; ".join([*others, agree])
    elif check.rounded:
        result.status = "other"
        result.message = (
            f"made on another platform: {check.rounded} values differ by rounding (at most {_ROUNDING:g}), none by more"
        )
    elif record.torn:
        result.status = "torn"
        result.message = f"the end is missing; all {check.good} turns up to there are right"
    else:
        result.message = f"all {check.good} turns and the score {result.score!r} are right"
    if check.elsewhere:
        made = record.header.get("environment") or {}
        here = check.environment.items()
        differing = [f"{key} {made.get(key)} (here {value})" for key, value in here if made.get(key) != value]
        result.notes.append(f"made with {', '.join(differing)}")
    if _expected(None, check.replay.laboratories.scenario) is None:
        result.notes.append(f"scenario {check.replay.laboratories.scenario.name} is the record's own (hash {actual})")
    return result


def _broken(broken: tuple[int, str]) -> str:
    return f"line {broken[0]} {broken[1]}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


assert set(EXIT_CODES) == set(get_args(Status))
