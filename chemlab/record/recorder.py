"""Recording of laboratory episodes line by line while they are played."""

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
from ..config.datamodel import validated
from ..config.files import check_target, locked, naming, sync_folder, write_bytes
from ..config.loading import dump_scenario
from ..kernels.arrays import IntArray, MaskArray, ObservationArray
from ..kernels.rng import checked_seed
from ..lab.engine import Laboratories
from ..physics.chemistry import AMOUNTS, PRESENT, TEMPERATURE
from ..roles.manager_state import RUNNING, STATUS_WORDS
from .format import FORMAT, Header, digest, seen_hash, to_text


class Play(NamedTuple):
    """Observation, mask and action of one agent."""

    agent: int
    """Index of the agent."""
    observation: ObservationArray
    mask: MaskArray | None
    action: Any


def _known_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a reset that affect an episode."""
    given = {key: options[key] for key in ("goal", "world") if options.get(key) is not None}
    return {key: int(value) if isinstance(value, np.integer) else value for key, value in given.items()}


def turn_facts(labs: Laboratories, member: int, plays: Sequence[Play]) -> dict[str, Any]:
    """Return the consequences of the turn that was just played, without zeros and empty values.

    Args:
        labs: the laboratories.
        member: environment index.
        plays: the turn's actions.

    Returns:
        ``rewards``, ``cost``, safety ``events`` and ``scores`` of ended experiments by agent; and ``lost``, the agents
        whose action was invalid.
    """
    agents, played = labs.agents, [(play.agent, labs.agents[play.agent]) for play in plays]
    facts = {
        "rewards": {name: x for name, x in zip(agents, labs.rewards[member].tolist(), strict=True) if x},
        "cost": {name: x for name, x in zip(agents, labs.cost[member].tolist(), strict=True) if x},
        "lost": [name for number, name in played if labs.roles[number].illegal[member]],
        "events": {name: events for number, name in played if (events := labs.events(number, member))},
        "scores": {name: x for name, x in zip(agents, labs.scores[member].tolist(), strict=True) if x == x},
    }
    return {key: fact for key, fact in facts.items() if fact}


class EpisodeLines:
    """Makes the lines of one laboratory's record; it has to be created right after the laboratory's reset.

    Recording writes these lines, and verification compares them with those of a file.

    Args:
        laboratories: the laboratories.
        member: environment index.
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
        roles = [array for role in laboratories.roles for array in role.arrays(member)]
        parts = [shelf.vessels[member], shelf.stock[member], shelf.waste[member], *roles]
        # Views that are made once save a tenth of the time of a turn.
        self._parts = [memoryview(part) if part.flags.c_contiguous else part for part in parts if part.size]

    def opening(
        self,
        seed: int | None,
        options: Mapping[str, Any],
        rounds: bool,
        policies: Mapping[str, str],
        environment: Mapping[str, str],
        version: str = __version__,
    ) -> dict[str, Any]:
        """Return the first line; the arguments are its keys that do not follow from the laboratory."""
        labs = self._labs
        split: dict[str, Any] = {}
        hidden: dict[str, Any] = {}
        if labs.worlds.active:
            # The salt of a private split is secret; its worlds are identified by their numbers.
            split = {"split": labs.worlds.split.public}
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
            "streams": {role.name: int(role.stream[self._m, 0]) for role in labs.roles},
            "materials": list(labs.shelf.layout.materials),
            "positions": positions,
            "hidden": hidden,
            "scenario": dump_scenario(labs.scenario),
        }

    def turn(self, tick: int, plays: Sequence[Play]) -> dict[str, Any]:
        """Return the line of the turn (or round of several agents) that was just played.

        Args:
            tick: laboratory tick before the turn.
            plays: the actions, in the agents' order.
        """
        labs, m = self._labs, self._m
        line: dict[str, Any] = {"turn": self.turns, "tick": tick, "play": {}}
        for play in plays:
            # The action as the simulator uses it: continuous actions are float64.
            action = np.asarray(play.action, dtype=None if labs.action_counts[play.agent] else np.float64)
            line["play"][labs.agents[play.agent]] = [seen_hash(play.observation, play.mask), action.tolist()]
        line |= turn_facts(labs, m, plays)
        for agent, reward in line.get("rewards", {}).items():
            self.rewards[agent] += reward
        for play in plays:
            if reading := labs.roles[play.agent].reading(play.action, m):
                line["reading"] = reading
        line["hidden"] = self._hidden()
        self.turns += 1
        return line

    def _hidden(self) -> dict[str, Any]:
        """Return the changes of the unobserved state since the previous line."""
        labs, m = self._labs, self._m
        vessels: dict[str, Any] = {}
        current = labs.shelf.vessels[m]
        for position in np.flatnonzero((current != self._vessels).any(axis=1)):
            row, previous = current[position], self._vessels[position]
            if not row[PRESENT]:
                vessels[str(position)] = None
            elif (
                row[TEMPERATURE] != previous[TEMPERATURE]
                or row[PRESENT] != previous[PRESENT]
                or (row[self._amounts] != previous[self._amounts]).any()
            ):
                vessels[str(position)] = [row[TEMPERATURE].item(), [x or 0 for x in row[self._amounts].tolist()]]
            previous[:] = row
        hidden: dict[str, Any] = {"vessels": vessels} if vessels else {}
        for key, values in (("stock", labs.shelf.stock[m]), ("waste", labs.shelf.waste[m])):
            if (values != self._bulk[key]).any():
                hidden[key] = [x or 0 for x in values.tolist()]
                self._bulk[key][:] = values
        hidden["state"] = self._state()
        return hidden

    def _state(self) -> str:
        """Return a hash of the laboratory's state."""
        return digest(b"".join(part if isinstance(part, memoryview) else part.tobytes() for part in self._parts))

    @property
    def over(self) -> bool:
        """True once the episode is over."""
        return bool(self._labs.state.status[self._m] != RUNNING)

    def closing(self) -> dict[str, Any]:
        """Return the last line, the result of the episode."""
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


def environment_here() -> dict[str, str]:
    """Return versions and platform that numbers may depend on."""
    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "llvm": ".".join(map(str, llvmlite.binding.llvm_version_info)),
        "platform": sys.platform,
        "machine": platform.machine(),
        "processor": llvmlite.binding.get_host_cpu_name(),
    }


def _decodable(name: str) -> str:
    """Replace undecodable bytes, which a path from the command line may contain."""
    return name.encode(errors="surrogateescape").decode(errors="replace")


class Recorder:
    """Writes an episode of one laboratory to a file.

    Use it as a context manager, or call :meth:`close`. Call :meth:`begin` after the laboratory's reset, and
    :meth:`turn` after every turn. The turn that ends the episode finishes the record. An unfinished record keeps the
    name ``FILE.part`` and is readable up to its last line.

    Args:
        path: path of the record; the file must not exist, unless ``force`` is True.
        laboratories: laboratories of the episode.
        member: environment index.
        policies: names of the agents' policies, for information.
        rounds: whether turns are rounds, in which busy benches act on observations of the tick's start (parallel API).
        force: replace the file at ``path``.
        held: keep the record in memory until the recorder is closed, because the first line has the seed and the true
            contents. If writing fails then, :meth:`close` may be called again.

    Raises:
        ValueError: ``path`` exists already, or cannot be written.
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
        self._policies = {agent: _decodable(name) for agent, name in (policies or {}).items()}
        self._file: BinaryIO | None = None
        self._held: list[bytes] | None = [] if held else None
        self._opening: dict[str, Any] = {}
        self._lines: EpisodeLines | None = None
        self._tick = 0
        for target in (self.path, self.part):
            check_target(target, force)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def begin(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Start the record of an episode right after the laboratory's reset.

        Args:
            seed: seed of the reset; None if the random streams continued (the record contains their states).
            options: options of the reset.

        Raises:
            DataError: a policy's name or the seed exceeds a record's limit.
            OSError: the file cannot be written.
            ValueError: another process is recording there.
        """
        if self._file is not None or self._held:
            raise ValueError(f"{self.path}: its episode is not over; a record holds one episode")
        seed, self._lines = checked_seed(seed), EpisodeLines(self._labs, self._member)
        opening = self._lines.opening(seed, options or {}, self._rounds, self._policies, environment_here())
        validated(Header, opening, f"{self.path}: header")  # values that could not be read back are not written
        self.part.parent.mkdir(parents=True, exist_ok=True)
        if self._held is None:
            self._file = self._opened()
        self._tick = 0
        self._opening = opening
        self._write(opening)

    def played_by(self, agent: str, policy: str) -> None:
        """Add a policy to those named for an agent, in a record that is held in memory."""
        names = self._opening.get("policies", {})
        known, policy = names.get(agent, ""), _decodable(policy)
        if self._held and policy not in known.split(" and "):
            names[agent] = f"{known} and {policy}" if known else policy
            self._held[0] = to_text(self._opening).encode() + b"\n"

    def _opened(self) -> BinaryIO:
        """Open the file for exclusive use; raise ValueError if another process is recording there."""
        file = self.part.open("ab" if self._force else "xb")
        try:
            # The process that held the lock may have renamed the file by now.
            held = locked(file.fileno()) and self.part.exists()
            if not (held and os.path.samestat(os.fstat(file.fileno()), self.part.stat())):
                raise ValueError(f"{self.part}: another process is recording there; wait for it or give another name")
            file.truncate(0)
        except BaseException:
            file.close()
            raise
        return file

    def turn(self, plays: Sequence[Play]) -> None:
        """Write the turn (or round of several agents) that was just played.

        Args:
            plays: the actions, in the agents' order.
        """
        if self._lines is None or (self._file is None and not self._held):
            raise ValueError(f"{self.path}: call begin() first, and turn() only before the end of the episode")
        self._write(self._lines.turn(self._tick, plays))
        self._tick = int(self._labs.state.ticks[self._member])
        if self._lines.over:
            self._write(self._lines.closing())
            self._lines = None
            if self._held is None:
                self._finish()

    def _finish(self) -> None:
        """Rename the finished record."""
        assert self._file is not None
        with naming(self.part):
            os.fsync(self._file.fileno())
        if os.name != "posix":  # other systems cannot rename an open file
            self.close()
        if self.path.exists() and not self._force:
            self.close()
            raise ValueError(f"{self.path}: the file was created by another process; the record is {self.part}")
        # Rename before closing, which releases the lock: another process must not truncate the file in between.
        self.part.replace(self.path)
        self.close()
        sync_folder(self.path.parent)

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
        """Close the file, or write a record held in memory; that of an unfinished episode is named ``FILE.part``.

        Raises:
            OSError: the file cannot be written.
            ValueError: a held record's file has been created by another process.
        """
        if self._held:
            path = self.part if self._lines is not None else self.path
            if path.exists() and not self._force:
                raise ValueError(f"{path}: the file was created by another process; move it away, and close again")
            write_bytes(path, b"".join(self._held))
            self._held = None
        file, self._file = self._file, None
        if file is not None:
            with naming(self.part):
                file.close()
