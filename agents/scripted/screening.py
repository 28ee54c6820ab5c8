"""Scripted agents of a screening: try all catalysts in turn, measure every batch, and submit the best batches."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from chemlab.config.scenario import Scenario
from chemlab.envs.players import Actions, Memory, Remembering
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.roles.bench import channel_slices
from chemlab.roles.reaction_bench import ReactionBench

from .belief import Belief, BeliefManager
from .script import Setting

_EQUIVALENTS, _CATALYST, _HEAT = 1.3, 0.5, 0.6
"""Constant conditions: equivalents of every reagent, share of the catalyst's supply, share of the temperature range."""


def catalysts(scenario: Scenario) -> list[str]:
    """Return the alternative catalysts of a scenario: materials of the stock that are on both sides of a reaction."""
    unchanged = {name for step in scenario.family.reaction for name in step.products if name in step.reactants}
    return [name for name in scenario.stock if name in unchanged]


class ScriptedScreening(Remembering):
    """Runs every experiment under constant conditions, each with the next catalyst.

    Args:
        bench: the bench, whose scenario has :func:`catalysts`.
    """

    _MEMORY = ("_turns",)

    def __init__(self, bench: ReactionBench) -> None:
        spec, names = bench.scenario, bench.reagent_names
        self._slices = channel_slices(bench.channels)
        self._temperature = next(channel for channel in bench.channels if channel.name == "temperature")
        self._step_k = bench.options.temperature_k.step
        self._catalysts = [names.index(name) for name in catalysts(spec) if name in names]
        most = max(spec.theoretical_maximum_mol.values())
        self._shares = np.array([min(_EQUIVALENTS * most / bench.options.reagents[name], 1.0) for name in names])
        self._shares[self._catalysts] = 0.0
        self._turns = Memory(1)

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        (tried,) = self._turns.recall(np.ones_like(step), members)
        now = self._temperature.unscaled(observation[:, self._slices["temperature"]][:, 0])
        warm = np.clip(0.5 + (self._temperature.unscaled(_HEAT) - now) / (2.0 * self._step_k), 0.0, 1.0)
        adding = np.where(step[:, None] == 0, self._shares, 0.0)
        which = np.array(self._catalysts)[tried[:, 0].astype(np.int64) % len(self._catalysts)]
        adding[np.arange(len(members)), which] = np.where(step == 0, _CATALYST, 0.0)
        self._turns.keep(members, tried + (step == 0)[:, None])
        return np.column_stack((warm, np.full(len(members), 0.5), adding))

    def seed(self, member: int, seed: int | np.random.SeedSequence) -> None:
        """Begin an episode of one member with the first catalyst."""
        members = np.array([member])
        self._turns.recall(np.zeros(1, dtype=np.int64), members)
        self._turns.keep(members, np.zeros((1, 1)))


@dataclass
class _Batches(Belief):
    """Batches of an episode; ``slots`` have not been tried yet.

    Attributes:
        done: slots with an ended experiment.
        worth: by slot, the measured value: amount times purity.
    """

    done: list[int] = field(default_factory=list)
    worth: dict[int, float] = field(default_factory=dict)


class ScreeningManager(BeliefManager[_Batches]):
    """Runs every vessel on a free reaction bench, measures it, and submits the best ones.

    Args:
        setting: the manager's laboratory; if not careful, it runs one vessel for each order and never measures.
    """

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting, ("hplc", "gas_chromatograph"))
        spec = setting.scenario
        self._agents = [name for name in spec.bench_agents() if name.rpartition("_")[0] not in setting.skip]
        table, (goal, *_) = setting.instruments, spec.lab_goals
        names = table.analytes[table.names.index(self._instrument)] if self._instrument else ()
        terms = spec.specifications.get(goal)
        among = (terms.purity_among if terms else None) or names
        self._goal_column = list(names).index(goal) if names else 0
        self._counted = np.array([name in among for name in names], dtype=np.float64)

    def _begin(self, observation: ObservationArray) -> _Batches:
        return _Batches(self._occupied(observation), list(range(len(self._orders))))

    def _learn(self, belief: _Batches, slot: int, reading: FloatArray, observation: ObservationArray) -> None:
        shares = reading[: len(self._counted)]
        # The vessels are alike, so that a mole fraction is proportional to an amount.
        made = shares[self._goal_column]
        belief.worth[slot] = float(made * made / max(shares @ self._counted, 1e-9))

    def _ended(self, belief: _Batches, agent: str, slot: int, observation: ObservationArray) -> None:
        belief.done.append(slot)

    def _started(self, belief: _Batches, agent: str, slot: int, more: list[Any]) -> None:
        self._removed(belief, slot)
        belief.worth.pop(slot, None)

    def _removed(self, belief: _Batches, slot: int) -> None:
        for slots in (belief.slots, belief.done):
            if slot in slots:
                slots.remove(slot)

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        batches, wait = self._kept[member], self._actions.encode("wait")
        enough = self._instrument is None and len(batches.done) + len(batches.running) >= len(batches.orders)
        for agent in self._agents:
            if agent in batches.running or not batches.slots or enough:
                continue
            start = self._actions.encode("start", agent, batches.slots[0], self._scenario.lab_goals[0])
            if mask[start]:
                batches.running[agent] = batches.slots.pop(0)
                return start
        for slot in batches.done:
            if self._instrument is None or slot in batches.worth:
                continue
            if mask[self._measure(slot)]:
                return self._update(batches, self._measure(slot))
        if batches.running and mask[wait]:
            return wait
        for slot in sorted(batches.done, key=lambda slot: -batches.worth.get(slot, 0.0)):
            for order in batches.orders:
                submit = self._encode_submit(slot, order)
                if mask[submit]:
                    return self._update(batches, submit)
        return int(mask.argmax())
