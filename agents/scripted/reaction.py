"""Scripted policy of the reaction bench: heats and adds exactly the reagents that the goal needs."""

from __future__ import annotations

import numpy as np

from chemlab.config.reactions import equation
from chemlab.envs.players import Actions
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.sampling import quantiles
from chemlab.physics.constants import GAS_CONSTANT
from chemlab.roles.bench import channel_slices
from chemlab.roles.reaction_bench import ReactionBench

from .script import revealed_column

_SAFE_PRESSURE = 0.68
"""Reading of the pressure gauge above which the piston moves out; the valve opens at 0.8."""
_SAFEST_PRESSURE = 0.45
"""The same bound if accidents are priced; another heating step must not open the valve."""
_HOLD_BACK = 0.4
"""Share of the experiment during which one reagent of an unwanted side reaction is withheld."""
_LOSS = 0.1
"""Accepted loss of a product per run by thermal decomposition, as a share."""


def _hottest(bench: ReactionBench) -> tuple[int, FloatArray, FloatArray] | None:
    """Return the temperature in K at which the share ``_LOSS`` of the product decomposes in one run.

    It is given as the column of the revealed rate constant in the bench's observation, shares of the prior, and the
    temperature at these quantiles; None if no single rate constant is revealed to the bench.
    """
    draws = bench.scenario.world.draws
    name = next((n for n, d in draws.items() if d.what == "pre_exponential" and bench.key in d.told), None)
    if name is None or draws[name].variables > 1:
        return None
    step = next(one for one in bench.scenario.family.reaction if equation(one) in draws[name].of)
    shares = np.linspace(0.001, 0.999, 999)
    factors = step.pre_exponential * quantiles(draws[name], shares)
    time = bench.step_limit * bench.options.tick
    kelvin = step.activation_energy_j_mol / (GAS_CONSTANT * np.log(factors * time / _LOSS))
    return revealed_column(bench, name), shares, kelvin


class ScriptedReaction:
    """Heats, and adds all of the reagents from which the goal is made.

    If the goal's reagents would also form a penalized by-product, one of them is withheld until the others have become
    intermediates (goal I of the fictitious reactions: C is withheld). A bench to which the rate of decomposition is
    revealed uses the highest temperature that it allows.

    Args:
        bench: the bench.
        careful: False heats regardless of the pressure gauge.
        margin_k: margin in K below the highest temperature that a revealed rate allows; negative: above it. None: the
            highest temperature at the median of the prior, regardless of the revealed rate.
    """

    def __init__(self, bench: ReactionBench, careful: bool = True, margin_k: float | None = 0.0) -> None:
        priced = bench.scenario.safety.reward_price > 0.0
        self._safe_pressure = (_SAFEST_PRESSURE if priced else _SAFE_PRESSURE) if careful else np.inf
        self._slices = channel_slices(bench.channels)
        reagents = bench.reagent_names
        family = bench.scenario.family
        penalized = set(bench.options.penalty)
        self._need = np.zeros((len(bench.goals.names), len(reagents)))
        self._late = np.zeros_like(self._need, dtype=bool)
        self._temperature = next(channel for channel in bench.channels if channel.name == "temperature")
        self._step_k = bench.options.temperature_k.step
        self._hottest, self._margin_k = _hottest(bench), margin_k
        self._hold_until = round(_HOLD_BACK * bench.spec.step_limit)
        for g, goal in enumerate(bench.goals.names):
            wanted = family.towards(goal)
            self._need[g] = [name in wanted for name in reagents]
            for step in family.reaction:
                side = set(step.products) & (penalized - {goal})
                culprits = [i for i, name in enumerate(reagents) if name in step.reactants and self._need[g, i]]
                if side and len(culprits) == len(step.reactants):
                    self._late[g, culprits[-1]] = True

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        goal = observation[:, self._slices["goal"]].argmax(axis=1)
        pressure = observation[:, self._slices["pressure"]][:, 0]
        adding = np.where(self._late[goal] & (step < self._hold_until)[:, None], 0.0, self._need[goal])
        close = pressure > self._safe_pressure
        warm = np.where(close, 0.5, 1.0)
        if self._hottest is not None:
            now = self._temperature.unscaled(observation[:, self._slices["temperature"]][:, 0].astype(np.float64))
            column, shares, kelvin = self._hottest
            quantile = 0.5 if self._margin_k is None else observation[:, column]
            wanted = np.interp(quantile, shares, kelvin) - (self._margin_k or 0.0)
            warm = np.minimum(warm, np.clip(0.5 + (wanted - now) / (2.0 * self._step_k), 0.0, 1.0))
        piston = np.where(close, 1.0, 0.5)
        return np.concatenate((warm[:, None], piston[:, None], adding), axis=1)
