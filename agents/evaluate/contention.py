"""Count contention between the orders of a laboratory during play."""

from __future__ import annotations

import numpy as np

from chemlab.envs.players import Actions, Policy
from chemlab.kernels.arrays import BoolArray, FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.physics.chemistry import PRESENT
from chemlab.roles.manager_state import ARRIVES, INSTRUMENTS, WITHIN
from chemlab.roles.reaction_bench import ReactionBench

CONTENDED = ("bench", "stock", "slot", "instrument", "deadline")
"""Kinds of contention: a kind of bench is all busy while an order has nothing at any bench; a bottle holds less than
an experiment may take of it; an idle bench cannot be begun on for want of free slots; the budget does not pay for a
measurement any more; an order has passed its deadline unmet. All but the last are counted in manager's turns, over and
over while they last; deadlines once an order, when the episode is over."""


class Contention:
    """Plays as another manager does, and counts what was contended for at its turns.

    Args:
        policy: the other manager.
        laboratories: where it plays.

    Attributes:
        counts: [N, 4] turns, of all but the last of :data:`CONTENDED`.
    """

    def __init__(self, policy: Policy, laboratories: Laboratories) -> None:
        self._policy, self._labs = policy, laboratories
        self.counts: FloatArray = np.zeros((len(laboratories.members), len(CONTENDED) - 1))
        labs = laboratories
        self._kinds = [np.flatnonzero(labs.rules.arrays.bench_of == kind) for kind in range(labs.rules.arrays.kinds)]
        self._supplies = []
        """Of every reagent of every bench: the bench, the material, mol that an experiment may take."""
        for b, bench in enumerate(labs.benches):
            if isinstance(bench, ReactionBench):
                rules = bench.rules.arrays
                self._supplies += [(b, m, full) for m, full in zip(rules.reagents, rules.full, strict=True)]

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        labs, rules = self._labs, self._labs.rules.arrays
        busy, occupied = labs.busy[:, members], labs.shelf.vessels[members, : rules.slots, PRESENT] > 0.0
        unserved = self._open(members).sum(axis=1) > busy.sum(axis=0)
        full = np.any([busy[kind].all(axis=0) for kind in self._kinds], axis=0)
        short = np.zeros(len(members), dtype=np.bool_)
        for b, material, mol in self._supplies:
            short |= ~busy[b] & (labs.shelf.stock[members, material] < mol * (1.0 - 1e-9))
        free = (~occupied & (labs.state.reserved[members] < 0)).sum(axis=1)
        crowded = np.any([~busy[b] & (free < rules.positions[b] - 1) for b in range(len(labs.benches))], axis=0)
        spent = np.zeros(len(members), dtype=np.bool_)
        if len(rules.price):
            spent = labs.state.charges[members, INSTRUMENTS] + rules.price.min() > rules.budget + 1e-12
        self.counts[members] += np.stack([full & unserved, short & unserved, crowded & unserved, spent], axis=1)
        return self._policy.act(observation, mask, step, members)

    def _open(self, members: IntArray) -> BoolArray:
        """[B, O] orders that the manager knows of and that can still be met."""
        state = self._labs.state
        known = ~state.filled[members]
        if state.terms.shape[1]:
            since = state.ticks[members, None] - state.terms[members, :, ARRIVES]
            known &= (since >= 0) & (since <= state.terms[members, :, WITHIN])
        return np.asarray(known)

    def events(self) -> FloatArray:
        """[N, 5] of each kind, once the episodes are over."""
        state = self._labs.state
        missed = np.zeros(len(self.counts))
        if state.terms.shape[1]:
            due = state.terms[:, :, ARRIVES] + state.terms[:, :, WITHIN]
            missed = (~state.filled & (state.ticks[:, None] > due)).sum(axis=1)
        return np.column_stack([self.counts, missed])
