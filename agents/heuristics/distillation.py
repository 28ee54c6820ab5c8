"""Scripted policy of the distillation bench: boil off what boils below the goal; if more than the goal is left,
or nothing was there to boil off, swap the receiver and distil the goal over."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.arrays import IntArray, MaskArray, ObservationArray
from chemlab.bench.base import CAMERA_PIXELS, channel_slices
from chemlab.bench.distillation import DistillationBench

__all__ = ["DistillationHeuristic"]

_SAME = 1e-3
_KJ_PER_L_K = 1.7
"""Rough heat capacity of an organic liquid, and below its rough heat of vaporization: enough to choose a step by."""
_KJ_PER_L = 200.0
_CAUTION = 0.7
_MARGIN_K = 4.0
_HEEL_PIXELS = 1
"""Of the goal, left in a vessel that must not boil dry."""

STRIP, SWAP, COLLECT, DONE = range(4)


class DistillationHeuristic:
    """Heats in steps that cannot overshoot, by the thermometer and the level; looks at the layers once the lighter
    materials are gone.

    Args:
        bench: the bench it is for.
        careful: True stops short of boiling the vessel dry where the scenario prices accidents; False heats with all
            there is.
    """

    def __init__(self, bench: DistillationBench, careful: bool = True) -> None:
        self._careful = careful
        self._heel = careful and bench.scenario.safety.reward_price > 0.0
        materials = bench.scenario.materials
        self._slices = channel_slices(bench.channels)
        gauges = {channel.name: channel for channel in bench.channels}
        self._temperature, self._volume = gauges["temperature"], gauges["volume"]
        liquids = {n: m.boiling_point_k for n, m in materials.items() if m.role in ("solvent", "solute")}
        highest = max(liquids.values(), default=0.0)
        self._strip_to, self._boils_at, self._next_boils_at = [], [], []
        for goal in bench.goals.names:
            point = liquids.get(goal)
            if point is None:  # the goal does not boil: drive everything else off
                self._strip_to.append(highest + _MARGIN_K)
                self._boils_at.append(np.inf)
            else:
                lower = max([t for t in liquids.values() if t < point - 1e-9], default=point - 2.0 * _MARGIN_K)
                self._strip_to.append(0.5 * (lower + point))
                self._boils_at.append(point)
        for point in self._boils_at:
            self._next_boils_at.append(min([t for t in liquids.values() if t > point + 1e-9], default=np.inf))
        self._capacity_l = bench.spec.start.capacity_l
        self._shade = [materials[goal].shade for goal in bench.goals.names]
        self._air = materials["air"].shade
        self._liquids = [materials[name].shade for name in liquids]
        processes = bench.options.process
        starts = np.cumsum([0, *(len(process.magnitudes) for process in processes)])
        heat = next(i for i, process in enumerate(processes) if process.kind == "heat")
        swap = next(i for i, p in enumerate(processes) if p.kind == "pour" and (p.vessel, p.target) == ("B1", "B2"))
        self._heats = sorted((m, int(starts[heat]) + i) for i, m in enumerate(processes[heat].magnitudes) if m > 0)
        self._swap = int(starts[swap]) + int(np.argmax(processes[swap].magnitudes))
        self._end = bench.end_action
        self._phase: dict[int, int] = {}
        self._memory: dict[int, tuple[float, float]] = {}

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.agents.policies.Policy`."""
        assert mask is not None, "the distillation bench has discrete actions"
        return np.array(
            [self._decide(o, m, int(s), int(i)) for o, m, s, i in zip(observation, mask, step, members, strict=True)],
            dtype=np.int64,
        )

    def get_memory(self) -> Any:
        """See :class:`chemlab.laboratory.policy.Policy`."""
        return copy.deepcopy((self._phase, self._memory))

    def set_memory(self, memory: Any) -> None:
        """See :class:`chemlab.laboratory.policy.Policy`."""
        self._phase, self._memory = copy.deepcopy(memory)

    def _heat(self, kilojoules: float) -> int:
        """The largest heating step of at most ``kilojoules`` (the smallest there is, if none)."""
        if not self._careful:
            return self._heats[-1][1]
        return next((action for q, action in reversed(self._heats) if q <= kilojoules), self._heats[0][1])

    def _shows(self, observation: ObservationArray, shades: list[float]) -> bool:
        """Whether any pixel of DV shows one of the materials."""
        picture = observation[:CAMERA_PIXELS]
        return any(bool((np.abs(picture - shade) < _SAME).any()) for shade in shades)

    def _strip_step(self, goal: int, kelvin: float, litres: float, member: int) -> float:
        """kJ that bring the contents nearer to the stripping temperature without boiling the goal."""
        # While something boils the thermometer stands still, and steps may grow; once it moves they start small again.
        last, trust = self._memory.get(member, (0.0, 1.0))
        trust = min(2.0 * trust, 64.0) if abs(kelvin - last) < 0.5 else 1.0
        self._memory[member] = (kelvin, trust)
        warming = _CAUTION * _KJ_PER_L_K * litres * (self._strip_to[goal] - kelvin)
        if not np.isfinite(self._boils_at[goal]):
            return max(warming, 2.0 * trust)
        # However much boils meanwhile, the last of it must not take the goal along: a goal that is left alone
        # in little volume is warmed by little heat.
        spare = _CAUTION * _KJ_PER_L_K * litres * (self._boils_at[goal] - kelvin)
        return min(max(warming, 0.25 * trust), max(spare, _KJ_PER_L * (litres - 0.25)))

    def _collect_step(self, goal: int, kelvin: float, litres: float, observation: ObservationArray) -> float:
        """kJ that boil the goal over, but not what is left of heavier liquids once the goal is gone."""
        boiling = _CAUTION * _KJ_PER_L * (litres - 0.02)
        if self._heel:
            left = int((np.abs(observation[:CAMERA_PIXELS] - self._shade[goal]) < _SAME).sum())
            boiling = _CAUTION * _KJ_PER_L * (left - _HEEL_PIXELS) / CAMERA_PIXELS * self._capacity_l
        step = max(boiling, _KJ_PER_L_K * litres * (self._boils_at[goal] - kelvin))
        picture = observation[:CAMERA_PIXELS]
        others = [shade for shade in self._liquids if abs(shade - self._shade[goal]) > _SAME]
        pixels = sum(int((np.abs(picture - shade) < _SAME).sum()) for shade in others)
        if pixels:
            heavier = pixels / CAMERA_PIXELS * self._capacity_l
            step = min(step, _CAUTION * _KJ_PER_L_K * heavier * (self._next_boils_at[goal] - kelvin))
        return step

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        goal = int(observation[self._slices["goal"]].argmax())
        if step == 0:
            self._memory.pop(member, None)
            # A vessel that shows the goal and nothing to boil off was brought here to be distilled over.
            shows_goal = self._shows(observation, [self._shade[goal]])
            others = [shade for shade in self._liquids if abs(shade - self._shade[goal]) > _SAME]
            alone = shows_goal and not self._shows(observation, others) and np.isfinite(self._boils_at[goal])
            self._phase[member] = SWAP if alone else STRIP
        t, v = self._temperature, self._volume
        kelvin = t.low + float(observation[self._slices["temperature"]][0]) * (t.high - t.low)
        litres = v.low + float(observation[self._slices["volume"]][0]) * (v.high - v.low)
        phase = self._phase[member]
        if phase == STRIP and kelvin >= self._strip_to[goal]:
            picture = observation[:CAMERA_PIXELS]
            other = (np.abs(picture - self._shade[goal]) > _SAME) & (np.abs(picture - self._air) > _SAME)
            phase = SWAP if other.any() and np.isfinite(self._boils_at[goal]) else DONE
            self._phase[member] = phase
        if phase == STRIP:
            return self._heat(self._strip_step(goal, kelvin, litres, member))
        if phase == SWAP:
            self._phase[member] = COLLECT
            if mask[self._swap]:
                return self._swap
            phase = COLLECT
        left = int((np.abs(observation[:CAMERA_PIXELS] - self._shade[goal]) < _SAME).sum())
        if phase == COLLECT and self._heel and left <= _HEEL_PIXELS:
            phase = DONE
        if phase == COLLECT and kelvin < self._boils_at[goal] + 1.0:
            return self._heat(self._collect_step(goal, kelvin, litres, observation))
        self._phase[member] = DONE
        return self._end
