"""Scripted policy of the distillation bench.

It boils off the materials with boiling points below the goal's. If materials other than the goal remain, or none had to
be boiled off, it swaps the receiver and distils the goal over.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np

from chemlab.envs.players import Actions, Memory, Remembering
from chemlab.kernels.arrays import BoolArray, Field, FloatArray, Handle, IntArray, MaskArray, ObservationArray
from chemlab.kernels.jit import inner, kernel, opened
from chemlab.kernels.tables import Table
from chemlab.roles.bench import CAMERA_PIXELS, channel_slices
from chemlab.roles.separation_benches import DistillationBench

from .script import SAME_SHADE, choices, shows

_KJ_PER_L_K, _KJ_PER_L = 1.7, 200.0
"""Rough heat capacity (kJ/(L K)) and heat of vaporization (kJ/L) of an organic liquid, for choosing heating steps."""
_CAUTION = 0.7
"""Share of the estimated heat that is used."""
_MARGIN_K = 4.0
"""Temperature difference in K to a boiling point at which a material is gone."""
_HEEL_PIXELS = 1
"""Pixels of the goal left in a vessel that must not boil to dryness."""

STRIP, SWAP, COLLECT, DONE = range(4)
_PHASE, _LAST_K, _TRUST, _KEPT = range(4)
"""Columns of the memory, and their number: phase; temperature (K) and factor of the least heat when last stripping."""
_SAME = np.float32(SAME_SHADE)


class _Plan(NamedTuple):
    """Parameters of the policy, from the bench. G goals, L liquids, H heating steps."""

    strip_to: Annotated[FloatArray, Field("G")]
    """[G] temperature in K at which the materials that boil below the goal are gone"""
    boils_at: Annotated[FloatArray, Field("G")]
    """[G] boiling point in K, infinite for a goal that does not boil"""
    next_boils_at: Annotated[FloatArray, Field("G")]
    """[G] the next higher boiling point in K"""
    shade: Annotated[ObservationArray, Field("G")]
    """[G] grey value of the goal"""
    liquids: Annotated[ObservationArray, Field("L")]
    """[L] grey values of liquids"""
    others: Annotated[BoolArray, Field("G L")]
    """[G, L] True if a liquid's grey value differs from the goal's"""
    air: Annotated[ObservationArray, Field("1")]
    """[1] grey value of air"""
    kilojoules: Annotated[FloatArray, Field("H")]
    """[H] heating steps in ascending order"""
    heats: Annotated[IntArray, Field("H")]
    """[H] their actions"""
    swap: Annotated[int, Field("")]
    """action that changes the receiver"""
    end: Annotated[int, Field("")]
    """action that ends the experiment"""
    goal_at: Annotated[int, Field("")]
    """column of the goal's one-hot"""
    gauge_at: Annotated[IntArray, Field("2")]
    """columns of temperature and volume"""
    gauge: Annotated[FloatArray, Field("2 2")]
    """their lowest and highest values in K and L"""
    capacity_l: Annotated[float, Field("")]
    careful: Annotated[int, Field("")]
    """1: heats in small steps; 0: with full power"""
    heel: Annotated[int, Field("")]
    """1: stops before the vessel boils to dryness"""


@inner
def _shows_others(picture: ObservationArray, goal: int, plan: _Plan) -> int:
    """Count the pixels of liquids whose grey values differ from the goal's."""
    count = 0
    for k in range(plan.liquids.shape[0]):
        if plan.others[goal, k]:
            count += shows(picture, plan.liquids[k])
    return count


@inner
def _shows_contents(picture: ObservationArray, goal: int, plan: _Plan) -> bool:
    """Return True if a pixel shows neither air nor the goal."""
    others = False
    for x in range(CAMERA_PIXELS):
        others = others or (abs(picture[x] - plan.shade[goal]) > _SAME and abs(picture[x] - plan.air[0]) > _SAME)
    return others


@inner
def _heat(kilojoules: float, plan: _Plan) -> int:
    """Return the largest heating step of at most ``kilojoules``, or else the smallest."""
    last = plan.heats.shape[0] - 1
    if plan.careful:
        while last > 0 and plan.kilojoules[last] > kilojoules:
            last -= 1
    return int(plan.heats[last])


@inner
def _strip_step(goal: int, kelvin: float, litres: float, kept: FloatArray, plan: _Plan) -> float:
    """Return the heat in kJ that brings the contents towards the stripping temperature without boiling the goal."""
    # While a component boils, the temperature is constant and steps may grow; when it rises again, steps restart
    # small.
    trust = min(2.0 * kept[_TRUST], 64.0) if abs(kelvin - kept[_LAST_K]) < 0.5 else 1.0
    kept[_LAST_K], kept[_TRUST] = kelvin, trust
    warming = _CAUTION * _KJ_PER_L_K * litres * (plan.strip_to[goal] - kelvin)
    if not math.isfinite(plan.boils_at[goal]):
        return float(max(warming, 2.0 * trust))
    # The step is limited so that the last of the light materials does not carry the goal over: a small volume of
    # goal that is left alone needs little heat.
    spare = _CAUTION * _KJ_PER_L_K * litres * (plan.boils_at[goal] - kelvin)
    return float(min(max(warming, 0.25 * trust), max(spare, _KJ_PER_L * (litres - 0.25))))


@inner
def _collect_step(picture: ObservationArray, goal: int, kelvin: float, litres: float, plan: _Plan) -> float:
    """Return the heat in kJ that boils the goal over, but not the heavier liquids that remain after it."""
    boiling = _CAUTION * _KJ_PER_L * (litres - 0.02)
    if plan.heel:
        left = shows(picture, plan.shade[goal])
        boiling = _CAUTION * _KJ_PER_L * (left - _HEEL_PIXELS) / CAMERA_PIXELS * plan.capacity_l
    step = max(boiling, _KJ_PER_L_K * litres * (plan.boils_at[goal] - kelvin))
    pixels = _shows_others(picture, goal, plan)
    if pixels:
        heavier = pixels / CAMERA_PIXELS * plan.capacity_l
        step = min(step, _CAUTION * _KJ_PER_L_K * heavier * (plan.next_boils_at[goal] - kelvin))
    return float(step)


@inner
def _gauge(observation: ObservationArray, which: int, plan: _Plan) -> float:
    """Return the temperature in K (0) or the fill level in L (1)."""
    low, high = plan.gauge[which, 0], plan.gauge[which, 1]
    return float(low + np.float64(observation[plan.gauge_at[which]]) * (high - low))


@kernel
def _decide(
    observation: ObservationArray,
    mask: MaskArray,
    step: IntArray,
    kept: FloatArray,
    handle: Handle,
    out: IntArray,
) -> None:
    """Decide for B experiments: ``kept`` [B, 3] memory, ``out`` [B] actions."""
    plan = opened(_Plan, handle)
    for b in range(out.shape[0]):
        picture, goal = observation[b], 0
        for g in range(1, plan.boils_at.shape[0]):
            if observation[b, plan.goal_at + g] > observation[b, plan.goal_at + goal]:
                goal = g
        kelvin, litres = _gauge(picture, 0, plan), _gauge(picture, 1, plan)
        boils = math.isfinite(plan.boils_at[goal])
        phase = int(kept[b, _PHASE])
        if step[b] == 0:
            # A vessel that contains the goal and nothing to boil off is distilled over.
            alone = boils and shows(picture, plan.shade[goal]) > 0 and not _shows_others(picture, goal, plan)
            phase = SWAP if alone else STRIP
            kept[b, _LAST_K], kept[b, _TRUST] = 0.0, 1.0
        if phase == STRIP and kelvin >= plan.strip_to[goal]:
            phase = SWAP if boils and _shows_contents(picture, goal, plan) else DONE
        out[b] = plan.end
        if phase == STRIP:
            out[b] = _heat(_strip_step(goal, kelvin, litres, kept[b], plan), plan)
        elif phase == SWAP and mask[b, plan.swap]:
            out[b], phase = plan.swap, COLLECT
        elif phase != DONE:
            empty = plan.heel and shows(picture, plan.shade[goal]) <= _HEEL_PIXELS
            phase = COLLECT if not empty and kelvin < plan.boils_at[goal] + 1.0 else DONE
            if phase == COLLECT:
                out[b] = _heat(_collect_step(picture, goal, kelvin, litres, plan), plan)
        kept[b, _PHASE] = phase


class ScriptedDistillation(Remembering):
    """Boils off lighter materials in heating steps that do not overshoot, then distils the goal over if needed.

    Heating steps are chosen from thermometer and fill level, and after stripping also from the camera picture.

    Args:
        bench: the bench.
        careful: True stops before the vessel boils to dryness if accidents are priced; False heats with full power.
    """

    def __init__(self, bench: DistillationBench, careful: bool = True) -> None:
        materials = bench.scenario.materials
        slices = channel_slices(bench.channels)
        gauges = [channel for name in ("temperature", "volume") for channel in bench.channels if channel.name == name]
        liquids = {n: m.boiling_point_k for n, m in materials.items() if m.role in ("solvent", "solute")}
        highest = max(liquids.values(), default=0.0)
        strip_to, boils_at = [], []
        for goal in bench.goals.names:
            point = liquids.get(goal)
            if point is None:  # the goal does not boil: all liquids are boiled off
                strip_to.append(highest + _MARGIN_K)
                boils_at.append(math.inf)
            else:
                lower = max([t for t in liquids.values() if t < point - 1e-9], default=point - 2.0 * _MARGIN_K)
                strip_to.append(0.5 * (lower + point))
                boils_at.append(point)
        following = [min([t for t in liquids.values() if t > point + 1e-9], default=math.inf) for point in boils_at]
        shade = np.array([materials[goal].shade for goal in bench.goals.names])
        grey = np.array([materials[name].shade for name in liquids])
        heats = sorted((q, action) for q, action in choices(bench, "heat").items() if q > 0)
        swaps = choices(bench, "pour", vessel="B1", target="B2")
        self._plan = Table(
            _Plan(
                strip_to=np.array(strip_to),
                boils_at=np.array(boils_at),
                next_boils_at=np.array(following),
                shade=shade.astype(np.float32),
                liquids=grey.astype(np.float32),
                others=np.abs(grey - shade[:, None]) > SAME_SHADE,
                air=np.array([materials["air"].shade], dtype=np.float32),
                kilojoules=np.array([q for q, _ in heats]),
                heats=np.array([action for _, action in heats]),
                goal_at=slices["goal"].start,
                gauge_at=np.array([slices[channel.name].start for channel in gauges]),
                gauge=np.array([(channel.low, channel.high) for channel in gauges]),
                swap=swaps[max(swaps)],
                end=bench.end_action,
                capacity_l=bench.spec.start.capacity_l,
                careful=int(careful),
                heel=int(careful and bench.scenario.safety.reward_price > 0.0),
            )
        )
        self._memory = Memory(_KEPT)

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        assert mask is not None, "the distillation bench has discrete actions"
        (kept,) = self._memory.recall(step, members)
        out = np.empty(len(members), dtype=np.int64)
        seen, legal = np.ascontiguousarray(observation), np.ascontiguousarray(mask)
        _decide(seen, legal, step, kept, self._plan.handle, out)
        self._memory.keep(members, kept)
        return out
