"""Scripted policy of the reaction bench: warm up, add what the goal needs and nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.config.draws import quantiles
from chemlab.config.reactions import equation
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.physics.constants import GAS_CONSTANT
from chemlab.roles.bench import channel_slices
from chemlab.roles.reaction_bench import ReactionBench

__all__ = ["ReactionHeuristic"]

_SAFE_PRESSURE = 0.68
"""Of the gauge (the valve opens at 0.8): above this the piston moves out."""
_SAFEST_PRESSURE = 0.45
"""The same where accidents are priced: one more step of heating must not open the valve."""
_HOLD_BACK = 0.4
"""Share of the experiment for which one reagent of an unwanted side reaction is held back."""

_LOSS = 0.1
"""Of a product that is lost again where it is too hot, what may be in a run."""


def _hottest(bench: ReactionBench) -> tuple[FloatArray, FloatArray] | None:
    """How hot a bench may be, K, at shares of the prior: where a reaction whose pre-exponential factor it is told takes
    no more than ``_LOSS`` time constants in a run. None where it is told none."""
    draws = [bench.scenario.world.draws[name] for name in bench.told]
    rates = [draw for draw in draws if draw.what == "pre_exponential" and draw.variables == 1]
    if not rates or rates[0] is not draws[0]:
        return None
    step = next(one for one in bench.scenario.family.reaction if equation(one) in rates[0].of)
    shares = np.linspace(0.001, 0.999, 999)
    factors = step.pre_exponential * quantiles(rates[0], shares)
    time = bench.step_limit * bench.options.tick
    return shares, step.activation_energy_j_mol / (GAS_CONSTANT * np.log(factors * time / _LOSS))


class ReactionHeuristic:
    """Adds at once all of every reagent on the way to the goal, hot, and in excess where one is (sodium).

    Where the goal's own reagents would also make a penalized by-product, one of them waits until the others have
    become intermediates (goal I of the fictitious reactions: C waits). A bench that is told how fast a product is lost
    again is kept as hot as that allows.

    Args:
        bench: the bench it is for.
        careful: False heats on whatever the pressure gauge shows.
    """

    def __init__(self, bench: ReactionBench, careful: bool = True) -> None:
        priced = bench.scenario.safety.reward_price > 0.0
        self._safe_pressure = (_SAFEST_PRESSURE if priced else _SAFE_PRESSURE) if careful else np.inf
        self._slices = channel_slices(bench.channels)
        reagents = bench.reagent_names
        family = bench.scenario.family
        penalized = set(bench.options.penalty)
        self._need = np.zeros((len(bench.goals.names), len(reagents)))
        self._late = np.zeros_like(self._need, dtype=bool)
        span = bench.options.temperature_k
        self._span = np.array([span.low, span.high, span.step])
        self._hottest = _hottest(bench)
        self._hold_until = round(_HOLD_BACK * bench.spec.step_limit)
        for g, goal in enumerate(bench.goals.names):
            wanted = family.towards(goal)
            self._need[g] = [name in wanted for name in reagents]
            for step in family.reaction:
                side = set(step.products) & (penalized - {goal})
                culprits = [i for i, name in enumerate(reagents) if name in step.reactants and self._need[g, i]]
                if side and len(culprits) == len(step.reactants):
                    self._late[g, culprits[-1]] = True

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.agents.policies.Policy`."""
        goal = observation[:, self._slices["goal"]].argmax(axis=1)
        pressure = observation[:, self._slices["pressure"]][:, 0]
        adding = np.where(self._late[goal] & (step < self._hold_until)[:, None], 0.0, self._need[goal])
        close = pressure > self._safe_pressure
        warm = np.where(close, 0.5, 1.0)
        if self._hottest is not None:
            low, high, most = self._span
            now = low + observation[:, self._slices["temperature"]][:, 0] * (high - low)
            wanted = np.interp(observation[:, self._slices["told"]][:, 0], *self._hottest)
            warm = np.minimum(warm, np.clip(0.5 + (wanted - now) / (2.0 * most), 0.0, 1.0))
        piston = np.where(close, 1.0, 0.5)
        return np.column_stack((warm, piston, adding))
