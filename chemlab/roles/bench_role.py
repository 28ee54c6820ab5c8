"""The role of a bench's agent: a bench with the experiments that it carries out in N laboratories."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..kernels.arrays import BoolArray, FloatArray, IntArray, MaskArray, ObservationArray, StreamArray
from .base import Quantity, Role, one_hot
from .bench import Bench, Experiments
from .maintenance import MOST_GAIN, wear_out
from .manager import charge_events, return_vessels
from .manager_actions import GOAL, GRADE
from .manager_state import MANAGER

if TYPE_CHECKING:
    from ..lab.engine import Laboratories


class BenchRole(Role):
    """A bench of N laboratories and the agent that operates it.

    Attributes:
        workplace: its kind of bench; one object may serve several roles.
        number: index of the bench among the benches.
        experiments: arrays of its experiments.
    """

    workplace: Bench

    def __init__(self, labs: Laboratories, number: int, bench: Bench, experiments: Experiments) -> None:
        resting = bench.end_action if bench.action_count else -1
        super().__init__(labs, experiments.agent, number, bench, resting)
        self.number, self.experiments, self._hides = number, experiments, labs.scenario.hides
        self._ended: IntArray = np.zeros(len(experiments.busy), dtype=np.int64)

    @property
    def turns_had(self) -> IntArray:
        return np.asarray(self.labs.state.bench_steps[self.number])

    @property
    def illegal(self) -> BoolArray:
        return np.asarray(self.experiments.illegal)

    @property
    def events(self) -> FloatArray:
        return np.asarray(self.experiments.events)

    @property
    def stream(self) -> StreamArray:
        return np.asarray(self.experiments.stream)

    def goal(self, member: int) -> str:
        return str(self.labs.scenario.goals[self.experiments.goal[member]])

    @property
    def first_position(self) -> int:
        """Position of its main vessel among those of a laboratory."""
        return int(self.labs.rules.arrays.first[self.number])

    def observe(self, members: IntArray, out: ObservationArray, rows: IntArray | None = None) -> None:
        seen = out if rows is None else np.empty((len(members), out.shape[1]), dtype=np.float32)
        self.workplace.observe(self.labs.shelf, self.experiments, members, seen)
        if self._hides:  # nothing of a vessel before the first turn
            seen[(self.experiments.steps[members] == 0) & (self.labs.state.cursor[members] == MANAGER)] = 0.0
        if rows is not None:
            out[rows] = seen

    def mask(self, members: IntArray, out: MaskArray) -> None:
        self.workplace.mask(self.labs.shelf, self.experiments, members, out)

    def begin(self, members: IntArray, asked: IntArray) -> None:
        """Begin experiments.

        Args:
            members: [B] laboratories.
            asked: [B, 5] rows of the manager's actions that start them.
        """
        self.experiments.goal[members] = asked[:, GOAL]
        if self.labs.scenario.grades:
            self.experiments.grade[members] = asked[:, GRADE]
        self.workplace.begin(self.labs.shelf, self.experiments, members)
        self.charge(members, begun=True)

    def act(self, members: IntArray, actions: npt.NDArray[Any]) -> None:
        self.workplace.act(self.labs.shelf, self.experiments, members, actions)
        wear_out(self.workplace, self.experiments, members)
        ended = self.charge(members)
        if ended:
            self.end(self._ended[:ended].copy())
        self.labs.pass_turn(members)

    def charge(self, members: IntArray, begun: bool = False) -> int:
        """Charge safety events and invalid actions of the last turn (or of the beginning); returns the number of
        experiments that have ended, the first so many of ``self._ended``."""
        labs, state = self.labs, self.labs.state
        cost, reward = state.cost[self.index], state.rewards[self.index]
        self.workplace.consequences(labs.shelf, self.experiments, members, cost, reward, begun)
        own = self.experiments.handle
        return charge_events(members, self.number, own, labs.table.handle, labs.rules.handle, self._ended)

    def end(self, members: IntArray) -> None:
        """End experiments: score, reward and report, and the vessels back to the shelf."""
        labs, state = self.labs, self.labs.state
        if self.workplace.spec.report is not None:
            state.report[members, self.number] = self.workplace.reported(labs.shelf, self.experiments, members)
        score = self.workplace.finish(labs.shelf, self.experiments, members)
        state.scores[self.index, members] = score
        labs.experiment_ended = True
        state.rewards[self.index, members] += labs.scenario.rewards.bench_local * score
        manager, rules, *rest = labs.handles()
        return_vessels(members, self.number, manager, rules, self.experiments.handle, *rest)

    def settle(self, members: IntArray, result: FloatArray, charges: FloatArray) -> None:
        self.labs.state.rewards[self.index, members] += self.labs.scenario.rewards.bench_team * result

    def state(self, members: IntArray) -> list[Quantity]:
        labs, rules, name = self.labs, self.labs.rules.arrays, self.name
        own = self.experiments.table.arrays
        busy = own.busy[members]
        most = rules.largest_capacity / float(labs.shelf.chemistry.world().molar_volume[rules.parts[:, 0]].min())
        goal = one_hot(own.goal[members], len(labs.scenario.goals)) * busy[:, None]
        origin = one_hot(labs.state.origin[members, self.number], rules.slots) * busy[:, None]
        limit, steps, baseline = self.workplace.spec.step_limit, own.steps[members] * busy, own.baseline[members] * busy
        parts = [
            Quantity("busy", "0 or 1", "whether an experiment is running", busy),
            Quantity("goal", "one-hot", "its goal", goal),
            Quantity("steps", "steps", "taken", steps, high=limit),
            Quantity("origin", "one-hot", "slot its vessel came from", origin),
            Quantity("baseline", "mol", "the score is the change from", baseline, low=-most, high=most),
            *self.workplace.memory(self.experiments, members),
        ]
        return [part._replace(name=f"{name}_{part.name}") for part in parts]

    def condition(self, members: IntArray) -> list[Quantity]:
        if self.workplace.spec.wear is None:
            return []
        labs, own, most = self.labs, self.experiments, float(np.log(MOST_GAIN))
        limit = labs.rules.arrays.tick_limit
        gain, life = np.log(own.gain[members]), np.minimum(own.life[members], limit)
        repair = np.maximum(labs.state.ready[members, self.number] - labs.state.ticks[members], 0)
        parts = [
            Quantity("gain", "ln", "logarithm of it: stirring, heating", gain, low=-most, high=most),
            Quantity("life", "ticks", "of work until it breaks", life, high=limit),
            Quantity("broken", "0 or 1", "whether it is broken", own.broken[members]),
            Quantity("repair", "ticks", "left of its repair", repair, high=limit),
        ]
        return [part._replace(name=f"{self.name}_{part.name}") for part in parts]

    def arrays(self, member: int) -> list[npt.NDArray[Any]]:
        return self.experiments.table.member(member)
