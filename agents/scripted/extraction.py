"""Scripted policy of the extraction bench: decants from metal, or washes, settles and drains repeatedly."""

from __future__ import annotations

import numpy as np

from chemlab.config.materials import litres_of
from chemlab.envs.players import Actions, Remembering
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.sampling import quantiles
from chemlab.roles.bench import CAMERA_PIXELS
from chemlab.roles.separation_benches import ExtractionBench

from .script import choices, count_pixels, revealed_column

_WASHES = 4
_TAKEN = 0.6
"""Share of an impurity that one wash should remove if the impurity's polarity is revealed to the bench."""
_MARGIN_K = 8.0
"""Margin in K at which the odds of that share are half as large."""

DECANT, ADD, MIX, SETTLE, DRAIN, DONE = range(6)


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

    _MEMORY: tuple[str, ...] = ("_phase", "_washes")

    wash_l = 0.05
    """Volume of one wash in litres."""

    def __init__(self, bench: ExtractionBench, careful: bool = True, margin_k: float | None = 0.0) -> None:
        materials = bench.scenario.materials
        violent = {name for step in bench.scenario.family.violent for name in step.reactants}
        solids = {name: m.shade for name, m in materials.items() if m.role == "solid"}
        self._metals = _greys(*(shade for name, shade in solids.items() if name in violent and careful))
        self._solids = _greys(*solids.values())
        add, mix, settle = (choices(bench, kind) for kind in ("add", "mix", "settle"))
        wash = next(str(process.material) for process in bench.options.process if process.kind == "add")
        self._wash_shade = materials[wash].shade
        self._wash = _greys(self._wash_shade)
        # (magnitude, action), the largest first
        self._drains = sorted(choices(bench, "drain", vessel="EV", target="B1").items(), reverse=True)
        self._add = add[min(add, key=lambda litre: abs(litre - self.wash_l))]
        odds = _TAKEN / (1.0 - _TAKEN) * 0.5 ** ((margin_k or 0.0) / _MARGIN_K)
        self._column, volumes = _wash_volumes(bench, wash)
        if margin_k is None:
            volumes = volumes[len(volumes) // 2 :][:1]
        self._adds = [add[min(add, key=lambda litre: abs(litre - odds * volume))] for volume in volumes]
        self._most = bench.spec.step_limit if self._adds else _WASHES
        self._mix, self._settle = mix[max(mix)], settle[max(settle)]
        self._end = bench.end_action
        self._phase: dict[int, int] = {}
        self._washes: dict[int, int] = {}

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        assert mask is not None, "the extraction bench has discrete actions"
        rows = zip(observation[:, :CAMERA_PIXELS], mask, step.tolist(), members.tolist(), strict=True)
        actions = np.array([self._decide(*row) for row in rows], dtype=np.int64)
        if self._adds:
            percentiles = np.rint(observation[:, self._column] * (len(self._adds) - 1)).astype(np.int64)
            actions = np.where(actions == self._add, np.array(self._adds)[percentiles], actions)
        return actions

    def _drain(self, pixels: int) -> int:
        """Return the largest drain of at most a number of pixels, or else the smallest."""
        percent = 100.0 * pixels / CAMERA_PIXELS
        return next((action for magnitude, action in self._drains if magnitude <= percent + 1e-9), self._drains[-1][1])

    def _decide(self, picture: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        if step == 0 or member not in self._phase:  # another policy may have played the first turns
            self._phase[member] = DECANT if count_pixels(picture, self._metals) else ADD
            self._washes[member] = 0
        if self._phase[member] == DECANT:
            solid = count_pixels(picture, self._solids)
            if solid:
                return self._drain(solid)
            # A remainder below one pixel may be invisible; draining one more pixel of liquid removes it.
            self._phase[member] = DONE
            return self._drains[-1][1]
        if self._phase[member] == DRAIN:
            drain = self._drain_lower(picture, mask)
            if drain is not None:
                return drain
            self._phase[member] = ADD
            self._washes[member] += 1
        phase = self._phase[member]
        if phase == DONE or (phase == ADD and (self._washes[member] >= self._most or not mask[self._add])):
            return self._end
        self._phase[member] += 1
        return {ADD: self._add, MIX: self._mix, SETTLE: self._settle}[phase]

    def _drain_lower(self, picture: ObservationArray, mask: MaskArray) -> int | None:
        """Return the action that drains the lower layer; None if it is drained."""
        lower = count_pixels(picture, self._wash)
        return self._drain(lower) if lower else None


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
