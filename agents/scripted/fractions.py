"""Scripted policy of a distillation bench with a column: collects a forerun and the goal fraction, then stops."""

from __future__ import annotations

import numpy as np

from chemlab.envs.players import Actions
from chemlab.kernels.arrays import IntArray, MaskArray, ObservationArray
from chemlab.roles.separation_benches import DistillationBench

from .real import ScriptedRealDistillation

_HEAVIER_K = 5.0
"""Difference in K to the goal's boiling point above which a material should stay in the pot."""
_END = 0.9
"""Temperature of the pot at which the goal fraction ends, as a share of the way from the goal's boiling point to the
next higher one. The pot, from which the goal is nearly gone, boils close to the latter.
"""
_HEEL_L = 0.01
"""Pot volume in litres below which heating stops."""
_SMALL_KJ = 10.0
"""Largest heating step in kJ during the goal fraction."""
_SOME = 0.02
"""Share of the pot that has distilled over before the end of the fraction is judged by the temperature."""
_LEFT_K = 3.0
"""Difference in K to a solvent's boiling point at which hardly any goal is left in it."""
_MORE = 1.2
"""Maximum volume of a dilute fraction relative to the largest possible volume of the goal."""

STRIP, COLLECT, DILUTE = range(3)


class ScriptedFraction(ScriptedRealDistillation):
    """Boils off the lighter materials; distils the goal over if a column can separate it from heavier ones.

    Before the goal fraction, the receiver is changed. The fraction ends shortly below the next higher boiling point. If
    the goal is so dilute in a solvent that the pot boils more than halfway to this temperature from the start, the
    fraction ends when the pot nearly boils at the solvent's boiling point, or when the largest possible volume of the
    goal has distilled over. The same applies to solids that no wash removes. The candidates and their boiling points
    are public.

    Args:
        bench: the bench.
        careful: False always heats with full power.
    """

    _MEMORY = ("_phase", "_full")

    def __init__(self, bench: DistillationBench, careful: bool = True) -> None:
        super().__init__(bench, careful)
        materials = bench.scenario.materials
        liquids = [m.boiling_point_k for m in materials.values() if m.role == "solvent"]
        washed = any(other.kind == "extraction" for other in bench.scenario.benches.values())
        solids = not washed and any(m.role == "solid" for m in materials.values())
        self._until_k: list[float | None] = []
        self._dilute_k: list[float] = []
        self._solvent_k: list[float] = []
        self._most_l: list[float] = []
        for goal in bench.goals.names:
            boils = materials[goal].boiling_point_k
            heavier = min((t for t in liquids if t > boils + _HEAVIER_K), default=None)
            if heavier is None and solids:
                heavier = boils + 2.0 * _HEAVIER_K
            separable = bench.options.stages > 1 and boils < bench.options.hottest_k
            self._until_k.append(boils + _END * (heavier - boils) if separable and heavier is not None else None)
            self._dilute_k.append(0.5 * (boils + (heavier or boils)))
            others = [materials[name].boiling_point_k for name in bench.spec.start.contents if name != goal]
            self._solvent_k.append(others[0] - _LEFT_K if len(others) == 1 else 0.0)
            kilograms = (
                bench.scenario.theoretical_maximum_mol.get(goal, 0.0) * materials[goal].molar_mass_g_mol / 1000.0
            )
            self._most_l.append(_MORE * kilograms / materials[goal].density_kg_l)
        swaps = bench.choices("pour", vessel="B1", target="B2")
        self._swap = swaps[max(swaps)] if swaps else None
        self._phase: dict[int, int] = {}
        self._full: dict[int, float] = {}
        """Litres in the pot when the receiver was changed, by environment index."""

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        assert mask is not None, "the distillation bench has discrete actions"
        stripping = super().act(observation, mask, step, members)
        out = []
        for i, (seen, legal, action) in enumerate(zip(observation, mask, stripping.tolist(), strict=True)):
            member, goal = int(members[i]), int(seen[self._slices["goal"]].argmax())
            if step[i] == 0 or member not in self._phase:  # another policy may have played the first turns
                self._phase[member] = STRIP
            until = self._until_k[goal]
            litres = self._volume.unscaled(float(seen[self._slices["volume"]][0]))
            if litres < _HEEL_L:
                out.append(self._end)
                continue
            if until is None or self._swap is None or (self._phase[member] == STRIP and action != self._end):
                out.append(action)
                continue
            if self._phase[member] == STRIP:
                self._phase[member], self._full[member] = COLLECT, litres
                if legal[self._swap]:
                    out.append(self._swap)
                    continue
            kelvin = self._temperature.unscaled(float(seen[self._slices["temperature"]][0]))
            heat = next((a for q, a in reversed(self._heats) if q <= _SMALL_KJ), self._heats[0][1])
            begun = litres > (1.0 - _SOME) * self._full[member]
            if self._phase[member] == COLLECT and kelvin > self._dilute_k[goal] and begun:
                self._phase[member] = DILUTE
            done = kelvin > until
            if self._phase[member] == DILUTE:
                over = self._full[member] - litres > self._most_l[goal]
                done = over or kelvin > max(until, self._solvent_k[goal])
            out.append(self._end if done or not legal[heat] else heat)
        return np.array(out, dtype=np.int64)
