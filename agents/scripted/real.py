"""Scripted policies of benches with the physics backend ``real``."""

from __future__ import annotations

import math

import numpy as np

from chemlab.envs.players import Actions
from chemlab.kernels.arrays import IntArray, MaskArray, ObservationArray
from chemlab.kernels.tables import Table
from chemlab.roles.bench import channel_slices
from chemlab.roles.reaction_bench import ReactionBench
from chemlab.roles.separation_benches import DistillationBench, ExtractionBench

from .extraction import ScriptedExtraction
from .script import choices

_FEED, _QUENCH = 0.6, 0.88
"""Shares of a reaction's duration: end of the feeding of liquid reagents, and beginning of the quench."""
_QUENCH_SHARE = 0.3
"""Share of the remaining quenching reagent that is added per step."""
_BELOW_BOILING_K = 8.0
"""Margin in K between the contents and the lowest boiling point."""
_GAIN = 2.0
"""Largest controller gain: K by which the jacket's setpoint is lowered per K of the contents' excess temperature."""


class ScriptedRealReaction:
    """Adds the solids first, feeds the liquids while the jacket cools, waits, and quenches water-sensitive reagents.

    Args:
        bench: the bench.
        careful: False adds everything at once and does not quench.
    """

    def __init__(self, bench: ReactionBench, careful: bool = True) -> None:
        self._slices = channel_slices(bench.channels)
        self._temperature = next(channel for channel in bench.channels if channel.name == "temperature")
        self._step_k = bench.options.temperature_k.step
        self._careful = careful
        materials, family = bench.scenario.materials, bench.scenario.family
        limit = bench.spec.step_limit
        self._feed_until, self._quench_from = round(_FEED * limit), round(_QUENCH * limit)
        reagents = bench.reagent_names
        dangerous = {n for step in family.violent if step.event != "none" for n in step.reactants} - {"water"}
        self._needed = np.array([[name in family.towards(goal) for name in reagents] for goal in bench.goals.names])
        quenching = {n for step in family.reaction if dangerous & set(step.reactants) for n in step.reactants}
        self._quench = np.array([n in quenching - dangerous for n in reagents]) & ~self._needed.any(axis=0)
        self._solid = np.array([materials[name].role == "solid" for name in reagents])
        present = {*bench.spec.start.contents, *reagents}
        boiling = min((materials[n].boiling_point_k for n in present if materials[n].role == "solvent"), default=400.0)
        self._wanted_k = min(boiling - _BELOW_BOILING_K, self._temperature.high - _BELOW_BOILING_K)
        warmed = sum(mol * materials[n].heat_capacity_j_mol_k for n, mol in bench.spec.start.contents.items())
        # Share of the difference to the setpoint that a step makes up; gains above 2 / share - 1 oscillate.
        share = 1.0
        if bench.options.jacket_w_k and warmed:
            share = 1.0 - math.exp(-bench.options.jacket_w_k * bench.options.tick / warmed)
        self._gain = min(_GAIN, 0.6 * (2.0 / share - 1.0))

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        goal = observation[:, self._slices["goal"]].argmax(axis=1)
        t = self._temperature  # the jacket has the same scale
        kelvin = t.unscaled(observation[:, self._slices["temperature"]][:, 0])
        jacket = t.unscaled(observation[:, self._slices["jacket"]][:, 0]) if "jacket" in self._slices else kelvin
        needed = self._needed[goal]
        if not self._careful:
            return np.column_stack((np.ones(len(kelvin)), np.full(len(kelvin), 0.5), needed))
        excess = kelvin - self._wanted_k
        target = np.clip(self._wanted_k - self._gain * (excess + _BELOW_BOILING_K), t.low, t.high)
        turn = np.clip(0.5 + (target - jacket) / (2.0 * self._step_k), 0.0, 1.0)
        # A constant rate, which empties the bottle at the end of feeding.
        share = 1.0 / np.maximum(self._feed_until - step, 1)
        calm = np.clip(1.0 - excess / _BELOW_BOILING_K, 0.0, 1.0)
        adding = np.where(self._solid, 1.0, (calm * share)[:, None]) * needed
        late = step >= self._quench_from
        adding = np.where(late[:, None], (calm * _QUENCH_SHARE)[:, None] * self._quench, adding)
        return np.column_stack((turn, np.full(len(kelvin), 0.5), adding))


_WASHES = 3


class ScriptedRealExtraction(ScriptedExtraction):
    """Washes with water several times: add, shake, settle, drain the aqueous layer at the bottom.

    Args:
        bench: the bench.
        careful: False washes once.
    """

    wash_l = 0.2

    def __init__(self, bench: ExtractionBench, careful: bool = True) -> None:
        super().__init__(bench)
        plan = self._plan.arrays
        most = _WASHES if careful else 1
        self._plan = Table(plan._replace(metals=plan.metals[:0], most=most, diffuse=1))


_KJ_PER_L_K, _KJ_PER_L = 1.8, 250.0
"""Rough heat capacity (kJ/(L K)) and heat of vaporization (kJ/L) of an organic liquid."""
_SHORT_OF_K = 6.0
"""Difference in K to the goal's boiling point at which stripping ends."""
_LEAST_KJ = 2.0
"""Minimum heating step in kJ."""


class ScriptedRealDistillation:
    """Boils off materials with boiling points below the goal's, and stops by the boiling temperature of the pot.

    Args:
        bench: the bench.
        careful: False always heats with full power.
    """

    def __init__(self, bench: DistillationBench, careful: bool = True) -> None:
        materials = bench.scenario.materials
        self._slices = channel_slices(bench.channels)
        gauges = {channel.name: channel for channel in bench.channels}
        self._temperature, self._volume = gauges["temperature"], gauges["volume"]
        hottest = bench.options.hottest_k
        boiling = [materials[goal].boiling_point_k for goal in bench.goals.names]
        self._stop_k = np.array([min(t, hottest) - _SHORT_OF_K for t in boiling])
        self._heats = sorted((q, action) for q, action in choices(bench, "heat").items() if q > 0)
        self._end = bench.end_action
        self._careful = careful

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        kelvin = self._temperature.unscaled(observation[:, self._slices["temperature"]][:, 0])
        litres = self._volume.unscaled(observation[:, self._slices["volume"]][:, 0])
        goal = observation[:, self._slices["goal"]].argmax(axis=1)
        return np.array(
            [self._decide(float(k), float(x), int(g)) for k, x, g in zip(kelvin, litres, goal, strict=True)],
            dtype=np.int64,
        )

    def _decide(self, kelvin: float, litres: float, goal: int) -> int:
        gap = self._stop_k[goal] - kelvin
        if gap <= 0.0:
            return self._end
        if not self._careful:
            return self._heats[-1][1]
        # Far below the end point, most of the pot has to evaporate; close to it, the pot only has to warm up.
        wanted = _KJ_PER_L_K * litres * gap + 0.1 * _KJ_PER_L * litres * min(gap / 100.0, 1.0)
        # Smaller steps would only compensate heat losses.
        return next((action for q, action in reversed(self._heats) if q <= max(wanted, _LEAST_KJ)), self._heats[-1][1])
