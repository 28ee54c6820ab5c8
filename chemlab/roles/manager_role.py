"""The role of the manager: its workplace, and the manager of N laboratories."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ..config.parts import blamed, checked_numbers
from ..kernels.arrays import BoolArray, FloatArray, IntArray, MaskArray, ObservationArray, StreamArray
from .base import Quantity, Role
from .bench import Observation, check_discrete, distinct_channels, load_parts, told_channel
from .maintenance import go_astray, renew
from .manager import BEGUN, MEASURED, OVER, RECALLED, REPAIRED, manager_act, manager_mask
from .manager_actions import FIRST, KIND, MEASURE, REPAIR, SECOND
from .manager_state import ARRIVES, MANAGER
from .manager_view import manager_channels, manager_observe, report_channels

if TYPE_CHECKING:
    from ..config.scenario import DemandSpec
    from ..lab.engine import Laboratories


def _score_meaning(demand: DemandSpec) -> str:
    """Describe the score of an episode."""
    paid, missed = "mol submitted x absolute purity / theoretical maximum", f"{demand.missed:g}"
    if demand.order:
        paid, missed = "price of each order that is met", f"{missed} x price"
    less = f", less {missed} for each order that pays nothing" if demand.missed else ""
    return f"{paid}{less} (the mean over orders), minus all costs"


class Manager:
    """The static part of the manager's role: channels and actions.

    Args:
        labs: laboratories that it is made for; it does not keep them.
    """

    key = kind = "manager"
    score_meaning: str

    def __init__(self, labs: Laboratories) -> None:
        self.scenario = spec = labs.scenario
        self.score_meaning = _score_meaning(spec.demand)
        self.step_limit = spec.limits.manager_actions
        self.actions = labs.actions
        self.terms = load_parts(spec.manager.reward, spec, "manager.reward", Callable)
        self.added = load_parts(spec.manager.observe, spec, "manager.observe", Observation)
        own = manager_channels(spec, labs.instruments, labs.rules.arrays)
        reports = report_channels(spec)
        self.told = spec.world.told_to("manager")
        told = [told_channel(self.told, spec.world.numbers(self.told))] if self.told else []
        self.reports_from = sum(channel.size for channel in own)
        self.told_from = self.reports_from + sum(channel.size for channel in reports)
        self.added_from = self.told_from + sum(channel.size for channel in told)
        self.added_channels = [part.declared(name, labs) for name, part in self.added.items()]
        self.channels = distinct_channels((*own, *reports, *told, *self.added_channels), f"{spec.origin}: manager")
        size = sum(channel.size for channel in self.channels)
        self.observation_space: gymnasium.spaces.Box = gymnasium.spaces.Box(0.0, 1.0, (size,), np.float32)
        self.action_space: gymnasium.Space[Any] = gymnasium.spaces.Discrete(len(self.actions))

    @property
    def action_meanings(self) -> list[str]:
        """Meaning of every action."""
        return self.actions.action_meanings

    @property
    def action_count(self) -> int:
        """Number of actions."""
        return len(self.actions)

    def action_words(self, action: Any) -> str:
        """An action in words."""
        return self.actions.words(int(action))

    def checked(self, agent: str, action: Any) -> npt.NDArray[Any]:
        """The action as an array of one member, or ``ValueError`` if it is outside the action space."""
        return np.array([check_discrete(agent, action, len(self.actions))])


class ManagerRole(Role):
    """The manager of N laboratories."""

    workplace: Manager

    def __init__(self, labs: Laboratories, name: str) -> None:
        super().__init__(labs, name, MANAGER, Manager(labs), labs.actions.encode("wait"))
        self._reporting = [b for b, bench in enumerate(labs.benches) if bench.spec.report is not None]
        self._no_events = np.zeros((len(labs.state.status), len(labs.scenario.safety_events)))

    @property
    def turns_had(self) -> IntArray:
        return self.labs.state.actions

    @property
    def illegal(self) -> BoolArray:
        return self.labs.state.illegal

    @property
    def events(self) -> FloatArray:
        return self._no_events

    @property
    def stream(self) -> StreamArray:
        return self.labs.state.stream

    def observe(self, members: IntArray, out: ObservationArray, rows: IntArray | None = None) -> None:
        labs, manager = self.labs, self.workplace
        if rows is None:
            rows = np.arange(len(members))
        manager_observe(members, *labs.handles(), out, rows)
        if self._reporting:
            size = manager.told_from - manager.reports_from
            reports = labs.state.report[members][:, self._reporting].reshape(len(members), size)
            out[rows, manager.reports_from : manager.told_from] = reports
        if manager.told:
            out[rows, manager.told_from : manager.added_from] = labs.state.told[members]
        at = manager.added_from
        for (name, part), channel in zip(manager.added.items(), manager.added_channels, strict=True):
            out[rows, at : at + channel.size] = part.seen(name, len(members), channel.size, labs, members)
            at += channel.size

    def mask(self, members: IntArray, out: MaskArray) -> None:
        manager_mask(members, *self.labs.handles(), out)

    def act(self, members: IntArray, actions: npt.NDArray[Any]) -> None:
        labs = self.labs
        since = labs.state.ticks[members]
        effects = manager_act(members, actions, *labs.handles())
        labs.age(members, since)
        if effects & (MEASURED | REPAIRED | BEGUN | RECALLED):
            self._carry_out(effects, members, labs.rules.arrays.table[actions])
        for name, term in self.workplace.terms.items():
            with blamed(name):
                earned = term(labs, members)
            labs.state.rewards[self.index, members] += checked_numbers(earned, members.shape, name)
        if effects & OVER:
            labs.settle(members)

    def _carry_out(self, effects: int, members: IntArray, asked: IntArray) -> None:
        """Carry out the effects (flags of :func:`~.manager.manager_act`) of actions ``asked`` [B, 5]."""
        state = self.labs.state
        if effects & MEASURED:
            sent = state.measured[members] >= 0
            self.measure(members[sent], asked[sent, SECOND])
        repaired = np.where((asked[:, KIND] == REPAIR) & ~state.illegal[members], asked[:, FIRST], -1)
        begun, recalled = state.begun[members], state.recalled[members]
        for role in self.labs.bench_roles:
            if effects & REPAIRED and (sent := repaired == role.number).any():
                renew(role.workplace, role.experiments, members[sent])
            if effects & BEGUN and (sent := begun == role.number).any():
                role.begin(members[sent], asked[sent])
            if effects & RECALLED and (sent := recalled == role.number).any():
                role.end(members[sent])

    def measure(self, members: IntArray, used: IntArray) -> None:
        """Let instruments ``used`` [B] read the vessels that actions have sent to them."""
        labs, state, bias = self.labs, self.labs.state, None
        if state.bias.shape[1]:
            go_astray(members, used, labs.table.handle, labs.rules.handle)
            bias = state.bias
        slots = state.measured[members]
        labs.instruments.read(labs.shelf, state.reading, state.stream, members, slots, used, bias)

    def settle(self, members: IntArray, result: FloatArray, charges: FloatArray) -> None:
        labs, state, demand = self.labs, self.labs.state, self.labs.scenario.demand
        share = labs.rules.arrays.share
        state.rewards[self.index, members] -= share * charges
        if demand.feedback != 0.0:  # the part of the result that no submission has been rewarded for yet
            state.rewards[self.index, members] += share * (result + charges)
            state.rewards[self.index, members] -= state.feedback[members, :, 2].sum(axis=1)
        elif demand.missed:
            met = labs.worth(members).mean(axis=1)
            state.rewards[self.index, members] += share * (result + charges - met)

    def reading(self, action: Any, member: int) -> dict[str, Any] | None:
        labs = self.labs
        kind, slot, instrument, *_ = labs.actions.table[int(action)].tolist()
        if kind != MEASURE or labs.state.illegal[member]:
            return None
        values = labs.state.reading[member, slot, slice(*labs.instruments.start[instrument : instrument + 2])]
        return {"slot": slot, "instrument": labs.instruments.names[instrument], "values": values.tolist()}

    def accounts(self, which: int | slice) -> dict[str, npt.NDArray[Any]]:
        """Further entries of its infos, of one laboratory or, with one more axis, of several.

        ``costs`` [items, as in :data:`~chemlab.roles.manager_state.COST_ITEMS`] so far, in units of the score; and by
        order ``goals`` [orders] (index into the scenario's, -1 before it arrives), ``submitted_mol`` [orders] and
        ``purity`` [orders] of the vessel submitted for it, as far as the manager knows (0 until then).
        """
        labs, state = self.labs, self.labs.state
        if isinstance(which, int):
            costs = labs.shown_charges(labs.members[which : which + 1])[0]
        else:
            costs = labs.shown_charges(labs.members[which])
        goals, told = state.goal[which].copy(), labs.feedback(which)
        if state.terms.shape[1]:
            goals[state.ticks[which, ..., None] < state.terms[which, ..., ARRIVES]] = -1
        return {"costs": costs, "goals": goals, "submitted_mol": told[..., 0], "purity": told[..., 1]}

    def condition(self, members: IntArray) -> list[Quantity]:
        labs, state, limit = self.labs, self.labs.state, self.labs.rules.arrays.tick_limit
        if not len(labs.rules.arrays.drifting):
            return []
        ticks = state.ticks[members, None]
        since, old = ticks - state.since[members], ticks - state.calibrated[members]
        return [
            Quantity("bias", "scaled", "of readings when last worked out, by value", state.bias[members], low=-1.0),
            Quantity("bias_age", "ticks", "since then, by instrument", since, high=limit),
            Quantity("trend", "scaled", "of the bias in a tick, by instrument", state.trend[members], low=-1.0),
            Quantity("calibrated", "ticks", "since the calibration, by instrument", old, high=limit),
        ]

    def arrays(self, member: int) -> list[npt.NDArray[Any]]:
        # Readings are the largest part, and are in the record already from the time they were taken.
        return self.labs.table.member(member, without="reading")
