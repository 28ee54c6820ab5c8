"""Count contention between the orders of a laboratory during an episode."""

from __future__ import annotations

import numpy as np

from chemlab.envs.players import Actions, Policy
from chemlab.kernels.arrays import BoolArray, FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.physics.chemistry import PRESENT
from chemlab.roles.manager_state import ARRIVES, INSTRUMENTS, WITHIN
from chemlab.roles.reaction_bench import ReactionBench

CONTENDED = ("bench", "stock", "slot", "instrument", "deadline")
"""Kinds of contention:

* ``bench``: all benches of a kind are busy while an open order has no experiment at any bench;
* ``stock``: a bottle holds less than an experiment at an idle bench may take;
* ``slot``: an idle bench cannot start because too few slots are free;
* ``instrument``: the remaining budget is below the lowest price of a measurement;
* ``deadline``: an order has passed its deadline unfilled.

The first four are counted in each manager's turn in which they hold; deadlines once per order, at the episode's end.
"""


class Contention:
    """Plays as another manager does, and counts contention at its turns.

    Args:
        policy: the other manager.
        laboratories: the laboratories in which it plays.

    Attributes:
        counts: [N, 4] number of turns for each kind of :data:`CONTENDED` but the last.
    """

    def __init__(self, policy: Policy, laboratories: Laboratories) -> None:
        self._policy, self._labs = policy, laboratories
        self.counts: FloatArray = np.zeros((len(laboratories.members), len(CONTENDED) - 1))
        labs = laboratories
        self._kinds = [np.flatnonzero(labs.rules.arrays.bench_of == kind) for kind in range(labs.rules.arrays.kinds)]
        self._supplies = []
        """(bench index, material index, mol that an experiment may take) of every reagent of every bench."""
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
        """Return [B, O] True for orders that have arrived and can still be fulfilled."""
        state = self._labs.state
        known = ~state.filled[members]
        if state.terms.shape[1]:
            since = state.ticks[members, None] - state.terms[members, :, ARRIVES]
            known &= (since >= 0) & (since <= state.terms[members, :, WITHIN])
        return np.asarray(known)

    def events(self) -> FloatArray:
        """Return [N, 5] the counts of all kinds; call it when the episodes are over."""
        state = self._labs.state
        missed = np.zeros(len(self.counts))
        if state.terms.shape[1]:
            due = state.terms[:, :, ARRIVES] + state.terms[:, :, WITHIN]
            missed = (~state.filled & (state.ticks[:, None] > due)).sum(axis=1)
        return np.column_stack([self.counts, missed])
