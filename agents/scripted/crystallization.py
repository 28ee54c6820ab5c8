"""Scripted policy of the crystallization bench: dissolve hot, filter, cool, seed, wait, filter, wash, dry."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from chemlab.config.pairs import REFERENCE_K, log_activity_coefficients, pair_table
from chemlab.config.scenario import Scenario
from chemlab.envs.players import Actions, Remembering
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.physics.constants import GAS_CONSTANT
from chemlab.roles.bench import channel_slices
from chemlab.roles.separation_benches import CrystallizationBench

from .script import choices

_PATIENCE = 30
"""Maximum number of steps until complete dissolution."""
_FULLEST = 0.85
"""Maximum fill level as a share of the vessel."""
_SPARE = 1.1
"""Solvent volume relative to the volume that would dissolve the crude product if it were pure goal."""
_HOT_K = 3.0
"""Margin in K to the bath's highest and lowest temperature."""
_COLD_K = 283.15
"""Lowest cooling temperature in K; below it impurities precipitate as well."""
_SEED_AT = 0.8
"""Ratio of solubility to dissolved amount for seeding crystals: past saturation, before spontaneous nucleation."""
_STILL = 0.01
"""Relative change of the solids' volume per step below which dissolution and growth are considered finished."""
_LEAST_SOLIDS = 5e-4
"""Share of the vessel's volume above which solids are worth filtering."""
_MOSTLY_SOLID = 0.8
"""Solids' share of the contents from which the product is redissolved; below it, crystals are collected from liquor."""
_THINNED = 2.0
"""Litres of antisolvent per litre of solution."""
_DRY = 0.9999
"""Solids' share of the contents above which they are dry."""
_WASHES = 2
_WASH_L = 0.05
_SEED_G = 0.05
_KJ_PER_L_K = 4.2
"""Heat capacity of the contents in kJ/(L K)."""

ADD, DISSOLVE, STRAIN, ASIDE, BACK, COOL, COLLECT, WASH, DRAIN, DRY = range(10)
_CLEARING = {ASIDE: ("filter", "CV", "F"), BACK: ("pour", "CV", "W"), COOL: ("pour", "F", "CV")}
"""Process, vessel and target of the steps of a hot filtration, by the phase that each leads to."""


def solubility(scenario: Scenario, solute: str, solvent: str, temperature_k: float) -> float:
    """Return the solubility of a solid in mol per litre of solvent, from its heat of fusion and activity coefficient.

    Args:
        scenario: source of materials and pairs; physics ``real``.
        solute, solvent: names of materials; the solute has a heat of fusion.
        temperature_k: temperature below the solute's melting point.

    Raises:
        ValueError: the solute does not crystallize.
    """
    material, liquid = scenario.materials[solute], scenario.materials[solvent]
    if material.real is None or material.real.fusion_enthalpy_j_mol is None or material.melting_point_k is None:
        raise ValueError(f"{solute!r} has no heat of fusion, so it does not crystallize")
    ideal = material.real.fusion_enthalpy_j_mol / GAS_CONSTANT * (1.0 / material.melting_point_k - 1.0 / temperature_k)
    table = pair_table((solute, solvent), scenario.pairs)
    tau: FloatArray = table.a + table.b / temperature_k + table.c * math.log(temperature_k / REFERENCE_K)
    low, high = -50.0, 0.0
    for _ in range(60):  # Bisect for the largest ln x at which the activity is below that of the crystals.
        middle = 0.5 * (low + high)
        x = math.exp(middle)
        gamma = log_activity_coefficients(np.array([x, 1.0 - x]), tau, table.alpha)
        low, high = (middle, high) if middle + float(gamma[0]) < ideal else (low, middle)
    x = math.exp(low)
    return x / (1.0 - x) * 1000.0 * liquid.density_kg_l / liquid.molar_mass_g_mol


@dataclass
class _Batch:
    """State of the script in one experiment."""

    phase: int = ADD
    solvent_l: float = 0.0
    """litres still to be added"""
    seed_k: float = 0.0
    solids_l: float = math.inf
    seeded: bool = False
    washes: int = 0
    solvent: str = "water"
    hot_k: float = math.inf
    patience: int = _PATIENCE
    """remaining steps until complete dissolution"""


class ScriptedCrystallization(Remembering):
    """Collects, washes and dries crystals; recrystallizes a crude product first.

    Crystals in liquor are collected, washed and dried. A crude product is dissolved in as much hot solvent as the
    goal's solubility requires, and the rest is filtered off. The solution is cooled, seeded just past saturation if the
    bench has seeds, and left until precipitation stops. The crystals are filtered off, washed twice with little
    solvent, and dried.

    Args:
        bench: the bench.
        careful: False skips hot filtration and seeding.
    """

    def __init__(self, bench: CrystallizationBench, careful: bool = True) -> None:
        self._bench, self._careful, self._seeds = bench, careful, careful and bool(bench.choices("seed"))
        self._slices = channel_slices(bench.channels)
        self._gauges = {channel.name: channel for channel in bench.channels}
        self._hot_k = bench.options.hottest_k - _HOT_K
        self._cold_k = max(_COLD_K, bench.options.coolest_k + _HOT_K)
        self._wait = self._most(math.inf, "settle")
        self._memory: dict[int, _Batch] = {}

    def _solvent_for(self, goal: str, mol: float, room_l: float) -> tuple[str, float, float]:
        """Return the solvent with the highest yield on cooling, its hot temperature in K, and its volume in L.

        Solvents that dissolve ``mol`` of the goal within the free volume ``room_l`` are preferred.
        """
        scenario = self._bench.scenario
        solvents: list[tuple[bool, float, str, float, float]] = []
        for process in self._bench.options.process:
            if process.kind != "add" or process.material is None or process.material == goal:
                continue
            hot_k = min(self._hot_k, scenario.materials[process.material].boiling_point_k - _HOT_K)
            hot, cold = (solubility(scenario, goal, process.material, t) for t in (hot_k, self._cold_k))
            litres = _SPARE * mol / hot
            solvents.append((litres <= room_l, 1.0 - cold / hot, process.material, hot_k, litres))
        if not solvents:
            raise ValueError(
                f"benches.{self._bench.key}: its scripted policy needs a process that adds a solvent; add it, or "
                "choose another policy (of evaluate, also --baseline)"
            )
        _, _, liquid, hot_k, litres = max(solvents)
        return liquid, hot_k, min(litres, max(room_l, 0.0))

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        assert mask is not None, "the crystallization bench has discrete actions"
        chosen = []
        for o, m, s, i in zip(observation, mask, step.tolist(), members.tolist(), strict=True):
            kelvin, litres, solids = (self._read(o, name) for name in ("temperature", "volume", "solids"))
            if s == 0 or i not in self._memory:  # another policy may have played the first turns
                self._memory[i] = self._procedure(litres, solids, int(o[self._slices["goal"]].argmax()))
            action = self._decide(self._memory[i], kelvin, litres, solids, m)
            chosen.append(action if m[action] else self._bench.end_action)
        return np.array(chosen, dtype=np.int64)

    def _read(self, observation: ObservationArray, name: str) -> float:
        """Return a gauge's value in its unit."""
        return float(self._gauges[name].unscaled(float(observation[self._slices[name]][0])))

    def _procedure(self, litres: float, solids: float, goal: int) -> _Batch:
        """Return the initial state for the vessel's contents.

        Mostly solid contents are redissolved; crystals of a slurry are collected; a solution is precipitated with the
        bench's poorest solvent.
        """
        if solids >= _MOSTLY_SOLID:
            return self._begin(litres, goal)
        if solids > _LEAST_SOLIDS:
            return _Batch(phase=COOL, seeded=True)
        name, scenario = self._bench.goals.names[goal], self._bench.scenario
        added = [str(process.material) for process in self._bench.options.process if process.kind == "add"]
        liquids = [liquid for liquid in added if liquid != name]
        worst = min(liquids, key=lambda liquid: solubility(scenario, name, liquid, self._cold_k))
        room = max(_FULLEST * self._bench.spec.start.capacity_l - litres, 0.0)
        return _Batch(solvent_l=min(_THINNED * litres, room), solvent=worst, hot_k=0.0, seed_k=math.inf)

    def _begin(self, crude_l: float, goal: int) -> _Batch:
        """Return the initial state for a recrystallization, with solvent and seeding point for a volume of product."""
        scenario, name = self._bench.scenario, self._bench.goals.names[goal]
        material = scenario.materials[name]
        mol = max(crude_l, 1e-6) * 1000.0 * material.density_kg_l / material.molar_mass_g_mol
        room = _FULLEST * self._bench.spec.start.capacity_l - crude_l
        liquid, hot_k, solvent = self._solvent_for(name, mol, room)
        low, high = self._cold_k, hot_k
        for _ in range(30):
            middle = 0.5 * (low + high)
            wanted = _SEED_AT * mol / max(solvent, 1e-9)  # the vessel may arrive full
            low, high = (middle, high) if solubility(scenario, name, liquid, middle) < wanted else (low, middle)
        return _Batch(solvent_l=solvent, seed_k=low, solvent=liquid, hot_k=hot_k)

    def _most(self, wanted: float, kind: str, **which: str) -> int:
        """Return the largest magnitude of at most ``wanted``, or else the smallest."""
        sizes = choices(self._bench, kind, **which)
        return sizes[max((size for size in sizes if size <= wanted), default=min(sizes))]

    def _warm(self, kelvin: float, litres: float, wanted_k: float) -> int:
        """Return the action that heats or cools towards a temperature, or waits close to it."""
        kilojoules = _KJ_PER_L_K * litres * (wanted_k - kelvin)
        heats = choices(self._bench, "heat")
        fitting = [(abs(q), a) for q, a in heats.items() if q * kilojoules > 0.0 and abs(q) <= abs(kilojoules)]
        return max(fitting)[1] if fitting else self._wait

    def _still(self, batch: _Batch, solids_l: float) -> bool:
        """Return True if the volume of the solids has stayed constant."""
        before, batch.solids_l = batch.solids_l, solids_l
        return abs(solids_l - before) <= _STILL * max(solids_l, 1e-9)

    def _decide(self, batch: _Batch, kelvin: float, litres: float, solids: float, mask: MaskArray) -> int:
        if batch.phase == ADD:
            adds = choices(self._bench, "add", material=batch.solvent)
            if batch.solvent_l > min(adds):
                size = max(size for size in adds if size <= batch.solvent_l)
                batch.solvent_l -= size
                return adds[size]
            batch.phase = DISSOLVE
        if batch.phase == DISSOLVE:
            still = self._still(batch, solids * litres)
            action = self._warm(kelvin, litres, batch.hot_k)
            batch.patience -= 1
            # The highest temperature is lower if the smallest heating step is too large, or the solvent boils first.
            if batch.patience and (not still or (kelvin < batch.hot_k - _HOT_K and action != self._wait)):
                return action
            batch.phase = STRAIN if self._careful and solids > _LEAST_SOLIDS else COOL
        if batch.phase in (STRAIN, ASIDE, BACK):
            batch.phase += 1
            kind, vessel, target = _CLEARING[batch.phase]
            return self._most(1.0, kind, vessel=vessel, target=target)
        if batch.phase == COOL:
            unseeded = self._seeds and not batch.seeded
            if unseeded and kelvin <= batch.seed_k:
                batch.seeded = True
                return self._most(_SEED_G, "seed")
            still = self._still(batch, solids * litres)
            if kelvin > self._cold_k + 1.0 or not still:
                action = self._warm(kelvin, litres, batch.seed_k if unseeded else self._cold_k)
                if not still or action != self._wait:
                    return action
            batch.phase = COLLECT
        if batch.phase == COLLECT:
            batch.phase = WASH
            return self._most(1.0, "filter", target="F")
        if batch.phase == WASH and batch.washes < _WASHES:
            batch.washes, batch.phase = batch.washes + 1, DRAIN
            return self._most(_WASH_L, "add", material=batch.solvent)
        if batch.phase == DRAIN:
            batch.phase = WASH
            return self._most(1.0, "filter", target="F")
        batch.phase = DRY
        dry = self._most(math.inf, "dry")
        return dry if solids < _DRY and mask[dry] else self._bench.end_action
