"""What a policy is, whoever made it: a batch of observations and masks in, a batch of actions out."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from chemlab.bench.base import Bench, MaskArray, ObservationArray
from chemlab.laboratory.core import Laboratories
from chemlab.scenario import Scenario
from chemlab.shelf import IntArray

__all__ = ["Policy", "RandomPolicy", "make_policies", "policy_names"]


class Policy(Protocol):
    """A policy for one role, evaluated on a batch; it sees what an RL agent sees and the public scenario."""

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """Actions for a batch.

        Args:
            observation: [B, size].
            mask: [B, actions] legal actions, or None where actions are continuous.
            step: [B] how many turns the agent has had in this experiment (the manager: in this episode). At 0 a
                policy with a memory forgets.
            members: [B] which member of the batch each row is, for policies with a memory.

        Returns:
            [B] int64 actions, or [B, n] float64 where actions are continuous.
        """
        ...  # a protocol has no body


class RandomPolicy:
    """Uniformly random legal actions.

    Args:
        size: numbers of a continuous action; ignored where there is a mask.
        seed: seed of the policy's own stream.
    """

    def __init__(self, size: int, seed: int | np.random.SeedSequence | None = None) -> None:
        self._size = size
        self._rng = np.random.default_rng(seed)

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`Policy`."""
        if mask is None:
            return self._rng.random((len(observation), self._size))
        # The n-th legal action, n drawn uniformly: one draw a row, however many actions there are.
        legal = mask.cumsum(axis=1)
        wanted = (self._rng.random(len(mask)) * legal[:, -1]).astype(np.int64) + 1
        return np.asarray((legal < wanted[:, None]).sum(axis=1))


def policy_names() -> tuple[str, ...]:
    """Names that :func:`make_policies` knows."""
    return ("heuristic", "random")


def make_policies(name: str, laboratories: Laboratories, seed: int | None = None) -> dict[str, Policy]:
    """One policy for each agent of a laboratory.

    Args:
        name: ``heuristic`` or ``random``.
        laboratories: whose agents they are for.
        seed: seed of random policies.

    Raises:
        ValueError: unknown name.
    """
    if name not in policy_names():
        raise ValueError(f"policy: known: {', '.join(policy_names())}; given {name!r}")
    seeds = np.random.SeedSequence(seed).spawn(len(laboratories.agents))
    policies: dict[str, Policy] = {}
    for i, agent in enumerate(laboratories.agents):
        if name == "random":
            shape = laboratories.action_space(i).shape
            policies[agent] = RandomPolicy(int(shape[0]) if shape else 0, seeds[i])
        elif i == 0:
            policies[agent] = manager_heuristic(laboratories.scenario, laboratories)
        else:
            policies[agent] = bench_heuristic(laboratories.benches[i - 1])
    return policies


def bench_heuristic(bench: Bench) -> Policy:
    """The scripted policy for a bench.

    Raises:
        ValueError: chemlab has none for this kind of bench.
    """
    from .heuristics.distillation import DistillationHeuristic
    from .heuristics.extraction import ExtractionHeuristic
    from .heuristics.reaction import ReactionHeuristic

    known: dict[str, type[Any]] = {
        "reaction": ReactionHeuristic,
        "extraction": ExtractionHeuristic,
        "distillation": DistillationHeuristic,
    }
    if bench.spec.kind not in known:
        raise ValueError(
            f"bench {bench.key!r}: no scripted policy for kind {bench.spec.kind!r}; known: {', '.join(known)}"
        )
    policy: Policy = known[bench.spec.kind](bench)
    return policy


def manager_heuristic(scenario: Scenario, laboratories: Laboratories) -> Policy:
    """The scripted manager for a scenario."""
    from .heuristics.manager import ManagerHeuristic

    return ManagerHeuristic(scenario, laboratories.channels, laboratories.actions, laboratories.instruments)
