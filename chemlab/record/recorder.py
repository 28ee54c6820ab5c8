"""Telling what happens in a laboratory as the lines of a record, and writing them while it happens."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, NamedTuple

import llvmlite
import numba
import numpy as np

from .. import __version__
from ..config.files import check_target, locked, naming, sync_folder
from ..config.loading import dump_scenario
from ..config.materials import validated
from ..kernels.arrays import IntArray, MaskArray, ObservationArray
from ..lab.engine import Laboratories
from ..physics.chemistry import AMOUNTS, PRESENT, TEMPERATURE
from ..roles.manager_state import RUNNING, STATUS_WORDS
from .format import FORMAT, Header, digest, seen_hash, to_text

__all__ = ["Play", "Recorder", "Witness", "environment_here"]


class Play(NamedTuple):
    """What one agent was shown and did."""

    agent: int
    """Index of the agent."""
    observation: ObservationArray
    mask: MaskArray | None
    action: Any


def _known_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Those options of a reset that an episode depends on."""
    given = {key: options[key] for key in ("goal", "world") if options.get(key) is not None}
    return {key: int(value) if isinstance(value, np.integer) else value for key, value in given.items()}


class Witness:
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
        shelf = laboratories.shelf
        own = [array for role in laboratories.roles for array in role.arrays(member)]
        parts = [shelf.vessels[member], shelf.stock[member], shelf.waste[member], *own]
        # Views, which stay: that they are looked up once makes a turn cheaper by a tenth.
        self._parts = [memoryview(part) if part.flags.c_contiguous else part for part in parts if part.size]

    def _streams(self) -> dict[str, int]:
        labs = self._labs
        return {role.name: int(role.stream[self._m, 0]) for role in labs.roles}

    def opening(
        self,
        seed: int | None,
        options: Mapping[str, Any],
        rounds: bool,
        policies: Mapping[str, str],
        environment: Mapping[str, str],
        version: str = __version__,
    ) -> dict[str, Any]:
        """What the episode begins with: the first line, of which a laboratory cannot know what is given here."""
        labs = self._labs
        split: dict[str, Any] = {}
        hidden: dict[str, Any] = {}
        if labs.worlds.active:
            # The salt of a private split is nobody else's; its worlds are told by their numbers.
            split = {"split": labs.worlds.split.name.partition(":")[0]}
            hidden["world"] = {"number": labs.worlds.number(self._m), "values": labs.worlds.values(self._m)}
        hidden |= self._hidden()
        positions = [f"slot_{s}" for s in range(labs.scenario.shelf.slots)]
        for agent, bench in zip(labs.bench_agents, labs.benches, strict=True):
            positions += [f"{agent}.{position}" for position in bench.positions]
        return {
            "format": FORMAT,
            "chemlab": version,
            "seed": seed,
            "options": _known_options(options),
            **split,
            "rounds": rounds,
            "policies": dict(policies),
            "environment": dict(environment),
            "agents": labs.agents,
            "goals": [labs.scenario.goals[goal] for goal in labs.state.goal[self._m].tolist()],
            "streams": self._streams(),
            "materials": list(labs.shelf.layout.materials),
            "positions": positions,
            "hidden": hidden,
            "scenario": dump_scenario(labs.scenario),
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
            if labs.illegal(play.agent)[m]:
                lost.append(agent)
            if happened := labs.events(play.agent, m):
                events[agent] = happened
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
        for play in plays:
            if reading := labs.roles[play.agent].reading(play.action, m):
                line["reading"] = reading
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
        return digest(b"".join(part if isinstance(part, memoryview) else part.tobytes() for part in self._parts))

    @property
    def over(self) -> bool:
        """Whether the episode is over."""
        return bool(self._labs.state.status[self._m] != RUNNING)

    def closing(self) -> dict[str, Any]:
        """What the episode came to."""
        labs, m = self._labs, self._m
        totals = zip(labs.scenario.safety_events, labs.safety_totals[m].tolist(), strict=True)
        result = {
            "status": STATUS_WORDS[int(labs.state.status[m])],
            "score": labs.result(self._member).item(),
            **labs.outcome(m),
            "rewards": self.rewards,
            "costs": labs.costs(m),
            "safety_events": {kind: value for kind, value in totals if value},
            "manager_actions": int(labs.state.actions[m]),
            "ticks": int(labs.state.ticks[m]),
            "turns": self.turns,
        }
        return {"end": result}


def _is_at(file: BinaryIO, path: Path) -> bool:
    """Whether an open file is the one at a path."""
    return os.path.samestat(os.fstat(file.fileno()), path.stat())


def environment_here() -> dict[str, str]:
    """What numbers could depend on besides chemlab."""
    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "llvm": ".".join(map(str, llvmlite.binding.llvm_version_info)),
        "platform": sys.platform,
        "machine": platform.machine(),
        "processor": llvmlite.binding.get_host_cpu_name(),
    }


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
        force: replace the file at ``path``.
        held: keep the record in memory until the episode is over or the recorder is closed, because the first line has
            the seed and the true contents.

    Raises:
        ValueError: ``path`` is there already, or is no file that can be written.
    """

    def __init__(
        self,
        path: str | Path,
        laboratories: Laboratories,
        member: int = 0,
        policies: Mapping[str, str] | None = None,
        rounds: bool = False,
        force: bool = False,
        held: bool = False,
    ) -> None:
        self.path = Path(path)
        self.part = self.path.parent / f"{self.path.name}.part"
        self._labs, self._member = laboratories, member
        self._rounds, self._force = rounds, force
        # A path from the command line may have bytes that are no text.
        self._policies = {
            agent: name.encode(errors="surrogateescape").decode(errors="replace")
            for agent, name in (policies or {}).items()
        }
        self._file: BinaryIO | None = None
        self._held: list[bytes] | None = [] if held else None
        self._witness: Witness | None = None
        self._tick = 0
        for there in (self.path, self.part):
            if there.is_file() and not force:
                raise ValueError(f"{there}: is already there; give another name, or --force to replace it")
            check_target(there)

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

        Raises:
            DataError: a policy's name or the seed is longer than a record may have it.
            OSError: the file cannot be written.
            ValueError: another process is recording there.
        """
        if self._file is not None or self._held:
            raise ValueError(f"{self.path}: its episode is not over; a record holds one episode")
        labs = self._labs
        self._witness = Witness(labs, self._member)
        opening = self._witness.opening(
            seed,
            options or {},
            self._rounds,
            self._policies,
            environment_here(),
        )
        validated(Header, opening, f"{self.path}: header")  # what could not be read again is not written either
        self.part.parent.mkdir(parents=True, exist_ok=True)
        if self._held is None:
            self._file = self._opened()
        self._tick = 0
        self._write(opening)

    def _opened(self) -> BinaryIO:
        """Open the file for this record alone.

        Raises:
            ValueError: another process is recording there.
        """
        file = self.part.open("ab" if self._force else "xb")
        try:
            # The process that held the lock may have moved the file to its final name by now.
            if not (locked(file.fileno()) and self.part.exists() and _is_at(file, self.part)):
                raise ValueError(f"{self.part}: another process is recording there; wait for it or give another name")
            file.truncate(0)
        except BaseException:
            file.close()
            raise
        return file

    def turn(self, plays: Sequence[Play]) -> None:
        """Write a turn that has just been played (a round, where the recorder is one of rounds).

        Args:
            plays: who acted, in the agents' order.
        """
        if self._witness is None or (self._file is None and not self._held):
            raise ValueError(f"{self.path}: begin() comes first, and nothing after the end of the episode")
        self._write(self._witness.turn(self._tick, plays))
        self._tick = int(self._labs.state.ticks[self._member])
        if self._witness.over:
            self._write(self._witness.closing())
            self._finish()

    def _finish(self) -> None:
        """Give the whole record its final name."""
        self._release()
        assert self._file is not None
        with naming(self.part):
            os.fsync(self._file.fileno())
        if os.name != "posix":  # elsewhere an open file keeps its name
            self.close()
        if self.path.exists() and not self._force:
            self.close()
            raise ValueError(f"{self.path}: somebody else has put a file there; the record is {self.part}")
        # Before the file is closed, which ends the lock: another process must not empty it in between.
        self.part.replace(self.path)
        self.close()
        sync_folder(self.path.parent)

    def _release(self) -> None:
        """Write what was held back."""
        held, self._held = self._held, None
        if held:
            self._file = self._opened()
            with naming(self.part):
                self._file.write(b"".join(held))
                self._file.flush()

    def _write(self, line: dict[str, Any]) -> None:
        try:
            text = to_text(line)
        except ValueError as error:
            where = f"turn {line['turn']}" if "turn" in line else "the beginning or the end"
            raise ValueError(f"{self.part}: {where} has a number that is not finite; it cannot be recorded") from error
        if self._held is not None:
            self._held.append(text.encode() + b"\n")
            return
        assert self._file is not None
        with naming(self.part):
            self._file.write(text.encode() + b"\n")
            self._file.flush()

    def close(self) -> None:
        """Close the file; the record of an unfinished episode stays ``FILE.part``."""
        self._release()
        file, self._file = self._file, None
        if file is not None:
            with naming(self.part):
                file.close()
