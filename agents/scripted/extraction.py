"""Scripted policy of the extraction bench: decants from metal, or washes, settles and drains repeatedly."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from chemlab.config.materials import litres_of
from chemlab.envs.players import Actions, Memory, Remembering
from chemlab.kernels.arrays import Field, FloatArray, Handle, IntArray, MaskArray, ObservationArray
from chemlab.kernels.jit import inner, kernel, opened
from chemlab.kernels.tables import Table
from chemlab.lab.sampling import quantiles
from chemlab.roles.bench import CAMERA_PIXELS
from chemlab.roles.separation_benches import ExtractionBench

from .script import choices, revealed_column, shows

_WASHES = 4
_TAKEN = 0.6
"""Share of an impurity that one wash should remove if the impurity's polarity is revealed to the bench."""
_MARGIN_K = 8.0
"""Margin in K at which the odds of that share are half as large."""
_NEAR, _AIR = np.float32(0.12), np.float32(0.05)
"""Maximum difference from the grey value of the wash, or of air, at which a pixel belongs to it (``diffuse``)."""

START, DECANT, ADD, MIX, SETTLE, DRAIN, DONE = range(7)
WASH = -1
"""Step that stands for decanting or for all washes."""
_AT, _PHASE, _WASHED, _KEPT = range(4)
"""Columns of the memory, and their number: step; phase of the wash; washes so far."""


class _Plan(NamedTuple):
    """Parameters of the policy, from the bench. P steps, M metals, S solids, D drains, A volumes."""

    steps: Annotated[IntArray, Field("P")]
    """[P] actions in their order; WASH among them"""
    metals: Annotated[ObservationArray, Field("M")]
    """[M] grey values of metals that are decanted from"""
    solids: Annotated[ObservationArray, Field("S")]
    """[S] grey values of solids"""
    wash: Annotated[ObservationArray, Field("1")]
    air: Annotated[ObservationArray, Field("1")]
    """[1] grey values of the wash and of air"""
    organic: Annotated[ObservationArray, Field("O")]
    """[0 or 1] grey value of the layer above the wash, if only that is known (``diffuse``)"""
    percent: Annotated[FloatArray, Field("D")]
    """[D] drains in percent of the vessel's height, the largest first"""
    drains: Annotated[IntArray, Field("D")]
    """[D] their actions"""
    adds: Annotated[IntArray, Field("A")]
    """[A] actions that add the wash, by percentile of the revealed polarity if there are several"""
    revealed_at: Annotated[int, Field("")]
    """column of the revealed polarity"""
    mix: Annotated[int, Field("")]
    settle: Annotated[int, Field("")]
    end: Annotated[int, Field("")]
    """actions that mix, settle, and end the experiment"""
    most: Annotated[int, Field("")]
    """maximum number of washes"""
    diffuse: Annotated[int, Field("")]
    """1: layers differ from the grey values of materials, and a drain must not exceed the lower layer"""


@inner
def _count(picture: ObservationArray, shades: ObservationArray) -> int:
    """Count the pixels whose grey value is one of ``shades``."""
    count = 0
    for k in range(shades.shape[0]):
        count += shows(picture, shades[k])
    return count


@inner
def _lower_layer(picture: ObservationArray, plan: _Plan) -> int:
    """Return the number of pixels of the wash, or with ``diffuse`` of the layer at the bottom that may contain it.

    A single layer that contains more than water is not drained.
    """
    if not plan.diffuse:
        return shows(picture, plan.wash[0])
    top = 0
    if plan.organic.shape[0] == 0:
        for x in range(CAMERA_PIXELS):
            top = x + 1 if abs(picture[x] - plan.wash[0]) < _NEAR else top
        return top
    for x in range(CAMERA_PIXELS - 1, -1, -1):
        nearer = abs(picture[x] - plan.organic[0]) < abs(picture[x] - plan.wash[0])
        top = x if nearer and abs(picture[x] - plan.air[0]) > _AIR else top
    return top


@inner
def _drain(pixels: int, plan: _Plan) -> int:
    """Return the number of the largest drain of at most ``pixels``; if there is none, the number of drains."""
    k = 0
    while k < plan.percent.shape[0] and plan.percent[k] > 100.0 * pixels / CAMERA_PIXELS + 1e-9:
        k += 1
    return k


@inner
def _wash(observation: ObservationArray, mask: MaskArray, kept: FloatArray, plan: _Plan) -> int:
    """Return the next action of decanting or of washing; ``end`` if nothing is left to do."""
    phase, last = int(kept[_PHASE]), plan.drains.shape[0] - 1
    if phase == START:
        phase = DECANT if _count(observation, plan.metals) else ADD
    action = plan.end
    if phase == DECANT:
        solid = _count(observation, plan.solids)
        # A remainder below one pixel may be invisible; draining one more pixel of liquid removes it.
        action = plan.drains[min(_drain(solid, plan), last)]
        phase = DECANT if solid else DONE
    elif phase == DRAIN:
        lower = _lower_layer(observation, plan)
        k = _drain(lower, plan)
        if lower and (not plan.diffuse or (k <= last and mask[plan.drains[k]])):
            action = plan.drains[min(k, last)]
        else:
            phase = ADD
            kept[_WASHED] += 1.0
    elif phase == MIX:
        action, phase = plan.mix, SETTLE
    elif phase == SETTLE:
        action, phase = plan.settle, DRAIN
    if phase == ADD and kept[_WASHED] < plan.most:
        share = observation[plan.revealed_at] * np.float32(plan.adds.shape[0] - 1)
        add = plan.adds[int(np.rint(share))]
        if mask[add]:
            action, phase = add, MIX
    kept[_PHASE] = phase
    return int(action)


@kernel
def _decide(observation: ObservationArray, mask: MaskArray, kept: FloatArray, handle: Handle, out: IntArray) -> None:
    """Decide for B experiments: ``kept`` [B, 3] memory, ``out`` [B] actions."""
    plan = opened(_Plan, handle)
    for b in range(out.shape[0]):
        out[b], at, looking = plan.end, int(kept[b, _AT]), True
        while looking and at < plan.steps.shape[0]:
            step = plan.steps[at]
            if step == WASH:
                out[b] = _wash(observation[b], mask[b], kept[b], plan)
                # Later steps work on what a wash has taken away.
                looking = out[b] == plan.end and kept[b, _WASHED] > 0.0 and at + 1 < plan.steps.shape[0]
                at += looking
            else:  # illegal steps are left out
                at += 1
                if mask[b, step]:
                    out[b], looking = step, False
        kept[b, _AT] = at


class ScriptedExtraction(Remembering):
    """Drains solids if there is metal at the bottom; otherwise washes.

    Metal must not meet water, so after draining the experiment ends with the product in B1. Washing adds the first
    solvent, mixes, settles and drains the lower layer into B1 several times: small washes extract more.

    If the polarity of impurities is revealed to the bench, it determines the volume of a wash, and the bench washes
    until the step limit.

    Args:
        bench: the bench.
        careful: False washes in any case.
        margin_k: margin of the team in K (see :class:`.reaction.ScriptedReaction`); a larger margin means smaller
            washes. None: a constant volume, regardless of the revealed polarity.
    """

    wash_l = 0.05
    """Volume of one wash in litres."""

    def __init__(self, bench: ExtractionBench, careful: bool = True, margin_k: float | None = 0.0) -> None:
        materials = bench.scenario.materials
        violent = {name for step in bench.scenario.family.violent for name in step.reactants}
        solids = {name: m.shade for name, m in materials.items() if m.role == "solid"}
        add, mix, settle = (choices(bench, kind) for kind in ("add", "mix", "settle"))
        wash = next(str(process.material) for process in bench.options.process if process.kind == "add")
        drains = sorted(choices(bench, "drain", vessel="EV", target="B1").items(), reverse=True)
        odds = _TAKEN / (1.0 - _TAKEN) * 0.5 ** ((margin_k or 0.0) / _MARGIN_K)
        column, volumes = _wash_volumes(bench, wash)
        most = bench.spec.step_limit if len(volumes) else _WASHES
        if margin_k is None:
            volumes = volumes[len(volumes) // 2 :][:1]
        litres = odds * volumes if len(volumes) else [self.wash_l]
        self._plan = Table(
            _Plan(
                steps=np.array([WASH]),
                metals=_greys(*(shade for name, shade in solids.items() if name in violent and careful)),
                solids=_greys(*solids.values()),
                wash=_greys(materials[wash].shade),
                air=_greys(materials["air"].shade),
                organic=_greys(),
                percent=np.array([percent for percent, _ in drains]),
                drains=np.array([action for _, action in drains]),
                adds=np.array([add[min(add, key=lambda size: abs(size - wanted))] for wanted in litres]),
                revealed_at=column,
                mix=mix[max(mix)],
                settle=settle[max(settle)],
                end=bench.end_action,
                most=most,
                diffuse=0,
            )
        )
        self._memory = Memory(_KEPT)

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        assert mask is not None, "the extraction bench has discrete actions"
        (kept,) = self._memory.recall(step, members)
        out = np.empty(len(members), dtype=np.int64)
        _decide(np.ascontiguousarray(observation), np.ascontiguousarray(mask), kept, self._plan.handle, out)
        self._memory.keep(members, kept)
        return out


def _greys(*shades: float) -> ObservationArray:
    return np.array(shades, dtype=np.float32)


def _wash_volumes(bench: ExtractionBench, wash: str) -> tuple[int, FloatArray]:
    """Return the column of an impurity's revealed polarity in the bench's observation, and [101] litres of a wash.

    The wash removes half of the impurity, by percentile of the polarity; no volumes if no polarity is revealed.
    """
    draws, materials = bench.scenario.world.draws, bench.scenario.materials
    draw = next((name for name in bench.told if draws[name].what == "polarity"), None)
    if draw is None:
        return 0, np.zeros(0)
    solvent = next(name for name in bench.spec.start.contents if materials[name].role == "solvent")
    polarity = quantiles(draws[draw], np.linspace(0.0, 1.0, 101))
    to_wash, to_solvent = (np.abs(polarity - float(materials[name].polarity or 0.0)) for name in (wash, solvent))
    litres = litres_of({solvent: bench.spec.start.contents[solvent]}, materials)
    return revealed_column(bench, draw), litres * to_wash / to_solvent
