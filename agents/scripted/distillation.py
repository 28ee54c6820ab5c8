"""Scripted policy of the distillation bench.

It boils off the materials with boiling points below the goal's. If materials other than the goal remain, or none had to
be boiled off, it swaps the receiver and distils the goal over.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from chemlab.kernels.arrays import IntArray, MaskArray, ObservationArray
from chemlab.roles.bench import CAMERA_PIXELS, Channel, channel_slices
from chemlab.roles.distillation_bench import DistillationBench

from .script import SAME_SHADE, Remembering, count_pixels

__all__ = ["ScriptedDistillation"]

_KJ_PER_L_K = 1.7
"""Rough heat capacity of an organic liquid in kJ/(L K); with the heat of vaporization below it selects heating
steps.
"""
_KJ_PER_L = 200.0
_CAUTION = 0.7
_MARGIN_K = 4.0
_HEEL_PIXELS = 1
"""Pixels of the goal left in a vessel that must not boil to dryness."""

STRIP, SWAP, COLLECT, DONE = range(4)


class _Seen(NamedTuple):
    """Observed quantities of one bench."""

    picture: ObservationArray
    """[pixels] camera picture of DV"""
    goal: int
    kelvin: float
    litres: float


class ScriptedDistillation(Remembering):
    """Heats in steps that cannot overshoot, guided by thermometer and fill level; uses the layers once lighter
    materials left.

    Args:
        bench: the bench.
        careful: True stops before the vessel boils to dryness if the scenario prices accidents; False heats with full
            power.
    """

    _MEMORY = ("_phase", "_memory")

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
                self._boils_at.append(math.inf)
            else:
                lower = max([t for t in liquids.values() if t < point - 1e-9], default=point - 2.0 * _MARGIN_K)
                self._strip_to.append(0.5 * (lower + point))
                self._boils_at.append(point)
        for point in self._boils_at:
            self._next_boils_at.append(min([t for t in liquids.values() if t > point + 1e-9], default=math.inf))
        self._capacity_l = bench.spec.start.capacity_l
        self._shade = [materials[goal].shade for goal in bench.goals.names]
        self._air = materials["air"].shade
        self._liquids = [materials[name].shade for name in liquids]
        processes = bench.options.process
        starts = np.cumsum([0, *(len(process.magnitudes) for process in processes)])
        heat = next(i for i, process in enumerate(processes) if process.kind == "heat")
        swap = next(i for i, p in enumerate(processes) if p.kind == "pour" and (p.vessel, p.target) == ("B1", "B2"))
        heats = sorted((m, int(starts[heat]) + i) for i, m in enumerate(processes[heat].magnitudes) if m > 0)
        self._kilojoules, self._heats = [m for m, _ in heats], [action for _, action in heats]
        self._swap = int(starts[swap]) + int(np.argmax(processes[swap].magnitudes))
        self._end = bench.end_action
        self._phase: dict[int, int] = {}
        self._memory: dict[int, tuple[float, float]] = {}

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.agents.policies.Policy`."""
        assert mask is not None, "the distillation bench has discrete actions"
        pictures, goals = observation[:, :CAMERA_PIXELS], observation[:, self._slices["goal"]].argmax(axis=1).tolist()
        gauges = self._gauge(observation, self._temperature), self._gauge(observation, self._volume)
        seen = map(_Seen, pictures, goals, *gauges)
        rows = zip(seen, mask, step.tolist(), members.tolist(), strict=True)
        return np.array([self._decide(*row) for row in rows], dtype=np.int64)

    def _gauge(self, observation: ObservationArray, channel: Channel) -> list[float]:
        """Return the value [B] of a gauge in its unit."""
        shown = observation[:, self._slices[channel.name]][:, 0].astype(np.float64)
        numbers: list[float] = (channel.low + shown * (channel.high - channel.low)).tolist()
        return numbers

    def _heat(self, kilojoules: float) -> int:
        """Return the largest heating step of at most ``kilojoules``, or else the smallest."""
        if not self._careful:
            return self._heats[-1]
        return self._heats[max(bisect_right(self._kilojoules, kilojoules) - 1, 0)]

    def _others(self, goal: int) -> list[float]:
        """Return the grey values of liquids that differ from the goal's."""
        return [shade for shade in self._liquids if abs(shade - self._shade[goal]) > SAME_SHADE]

    def _strip_step(self, goal: int, kelvin: float, litres: float, member: int) -> float:
        """Return the heat in kJ that brings the contents towards the stripping temperature without boiling the goal."""
        # While a component boils, the temperature is constant and steps may grow; when it rises again, steps restart
        # small.
        last, trust = self._memory.get(member, (0.0, 1.0))
        trust = min(2.0 * trust, 64.0) if abs(kelvin - last) < 0.5 else 1.0
        self._memory[member] = (kelvin, trust)
        warming = _CAUTION * _KJ_PER_L_K * litres * (self._strip_to[goal] - kelvin)
        if not math.isfinite(self._boils_at[goal]):
            return max(warming, 2.0 * trust)
        # The step is limited so that the last of the light materials does not carry the goal over: a small volume of
        # goal that is left alone needs little heat.
        spare = _CAUTION * _KJ_PER_L_K * litres * (self._boils_at[goal] - kelvin)
        return min(max(warming, 0.25 * trust), max(spare, _KJ_PER_L * (litres - 0.25)))

    def _collect_step(self, seen: _Seen) -> float:
        """Return the heat in kJ that boils the goal over, but not the heavier liquids that remain after it."""
        picture, goal, kelvin, litres = seen
        boiling = _CAUTION * _KJ_PER_L * (litres - 0.02)
        if self._heel:
            left = count_pixels(picture, [self._shade[goal]])
            boiling = _CAUTION * _KJ_PER_L * (left - _HEEL_PIXELS) / CAMERA_PIXELS * self._capacity_l
        step = max(boiling, _KJ_PER_L_K * litres * (self._boils_at[goal] - kelvin))
        pixels = count_pixels(picture, self._others(goal))
        if pixels:
            heavier = pixels / CAMERA_PIXELS * self._capacity_l
            step = min(step, _CAUTION * _KJ_PER_L_K * heavier * (self._next_boils_at[goal] - kelvin))
        return step

    def _decide(self, seen: _Seen, mask: MaskArray, step: int, member: int) -> int:
        picture, goal, kelvin, litres = seen
        if step == 0:
            self._memory.pop(member, None)
            # A vessel that contains the goal and nothing to boil off is distilled over.
            alone = math.isfinite(self._boils_at[goal]) and count_pixels(picture, [self._shade[goal]]) > 0
            alone = alone and not count_pixels(picture, self._others(goal))
            self._phase[member] = SWAP if alone else STRIP
        phase = self._phase[member]
        if phase == STRIP and kelvin >= self._strip_to[goal]:
            other = (np.abs(picture - self._shade[goal]) > SAME_SHADE) & (np.abs(picture - self._air) > SAME_SHADE)
            phase = SWAP if other.any() and math.isfinite(self._boils_at[goal]) else DONE
            self._phase[member] = phase
        if phase == STRIP:
            return self._heat(self._strip_step(goal, kelvin, litres, member))
        if phase == SWAP:
            self._phase[member] = COLLECT
            if mask[self._swap]:
                return self._swap
            phase = COLLECT
        if phase == COLLECT and self._heel and count_pixels(picture, [self._shade[goal]]) <= _HEEL_PIXELS:
            phase = DONE
        if phase == COLLECT and kelvin < self._boils_at[goal] + 1.0:
            return self._heat(self._collect_step(seen))
        self._phase[member] = DONE
        return self._end
