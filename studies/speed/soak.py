"""Soak test: ten thousand episodes of random play, legal and illegal, on every scenario.

    python studies/speed/soak.py                      all scenarios, 10,000 episodes each
    python studies/speed/soak.py --episodes 500 wurtz_safe

In every round: no exception, rewards and costs are finite, and every observation of an agent with a turn is in [0, 1].
At the end of every episode, and in all laboratories every 64 rounds: the atoms of each element (and the charge) on
shelf and benches, in bottles, waste and delivered vessels equal the initial ones to 1e-9; amounts are finite and not
negative. At the end: the memory of the process has not grown. Prints JSON; the exit code is 1 if a bound is violated.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab import BatchedLaboratory
from chemlab.agents.random_policy import RandomPolicy
from chemlab.config.inherit import scenario_names
from chemlab.config.scenario import SAFETY_EVENTS
from chemlab.kernels.arrays import FloatArray, IntArray, ObservationArray
from chemlab.kernels.jit import kernel
from chemlab.lab.hidden import World
from chemlab.physics.chemistry import element_matrix
from chemlab.roles.manager_actions import SUBMIT
from chemlab.roles.manager_state import LIMIT

LARGEST_DRIFT = 1e-9
LARGEST_GROWTH_MIB = 8.0
BOLD = 0.1
"""Share of actions drawn from the whole space, legal or not."""
PATIENT = 0.75
"""Share of laboratories with rare submissions and ends of experiments, so that outer limits are reached."""


@kernel
def _count_outside(values: ObservationArray, rows: IntArray) -> int:
    """Count numbers of the given rows outside [0, 1] (NaN counts)."""
    outside = 0
    for i in range(rows.shape[0]):
        for j in range(values.shape[1]):
            outside += not 0.0 <= values[rows[i], j] <= 1.0
    return outside


def resident_mib() -> float:
    """Return the resident memory of the process in MiB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096 / 2**20


class _Watched(BatchedLaboratory):
    """Laboratories whose contents are summed before the end of an episode resets them."""

    def __init__(self, members: int, scenario: str) -> None:
        super().__init__(members, scenario, copy=False)
        self.atoms_in = element_matrix(self.scenario).T
        self.atoms: FloatArray = np.zeros((members, self.atoms_in.shape[1]))
        self.drift = self.charge = 0.0
        self.negative = self.limits = 0
        self.playing = False
        self.events = np.zeros(len(SAFETY_EVENTS))

    def _restart(self, members: IntArray, goal: str | None = None, world: World | None = None) -> None:
        if self.playing:
            self.weigh(members)
            self.limits += int((self.laboratories.state.status[members] == LIMIT).sum())
            self.events += self.laboratories.safety_totals[members].sum(axis=0)
        super()._restart(members, goal, world)
        self.playing = True
        self.atoms[members] = self._weight(members)

    def _weight(self, members: IntArray) -> FloatArray:
        labs = self.laboratories
        total = labs.shelf.total()[members]
        return np.asarray((total + labs.state.delivered[members]) @ self.atoms_in)

    def weigh(self, members: IntArray) -> None:
        """Compare the atoms of some laboratories with the initial ones; the last column is the charge."""
        found, begun, shelf = self._weight(members), self.atoms[members], self.laboratories.shelf
        change = np.abs(found - begun)[:, :-1] / np.maximum(begun[:, :-1], 1e-3)
        self.drift = max(self.drift, float(change.max()))
        self.charge = max(self.charge, float(np.abs(found[:, -1]).max()))
        for array in (shelf.vessels[members], shelf.stock[members], shelf.waste[members]):
            self.negative += int((~np.isfinite(array)).sum())
        for array in (shelf.amounts[members], shelf.stock[members], shelf.waste[members]):
            self.negative += int((array < 0.0).sum())


def soak(scenario: str, episodes: int, members: int = 256, seed: int = 0) -> dict[str, Any]:
    """Return the figures of ``episodes`` random episodes."""
    batch = _Watched(members, scenario)
    labs, everyone = batch.laboratories, batch.laboratories.members
    rng = np.random.default_rng(seed)
    policies = [
        RandomPolicy(0 if count else space.shape[0], np.random.SeedSequence([seed, number]))  # type: ignore[index]
        for number, (space, count) in enumerate(
            zip((labs.action_space(i) for i in range(len(labs.agents))), labs.action_counts, strict=True)
        )
    ]
    submits = labs.actions.table[:, 0] == SUBMIT
    patient = rng.random(members) < PATIENT
    figures: dict[str, Any] = {"scenario": scenario, "members": members}
    ended = rounds = turns = outside = unsound = lost = 0
    warm, begun = 0.0, time.perf_counter()
    seen, infos = batch.reset(seed=seed)
    while ended < episodes:
        actions: dict[str, npt.NDArray[Any]] = {}
        for number, agent in enumerate(batch.possible_agents):
            turn = infos[agent]["has_turn"]
            rows = np.flatnonzero(turn)
            if not len(rows):
                continue
            turns += len(rows)
            outside += _count_outside(seen[agent], rows)
            mask = infos[agent].get("action_mask")
            if mask is None:
                numbers = policies[number].act(seen[agent], None, everyone, everyone)
                actions[agent] = np.where(rng.random(numbers.shape) < 0.2, numbers.round(), numbers)
                continue
            mask = mask.copy()
            rare = patient & (rng.random(members) < 0.98)
            kept = mask[rare]
            kept[:, submits if number == labs.manager.index else labs.roles[number].resting_action] = 0
            # If no other action is legal, it is kept.
            mask[np.flatnonzero(rare)[kept.any(axis=1)]] = kept[kept.any(axis=1)]
            mask[rng.random(members) < BOLD] = 1
            actions[agent] = policies[number].act(seen[agent], mask, everyone, everyone)
        seen, rewards, over, _, infos = batch.step(actions)
        rounds += 1
        ended += int(over.sum())
        for number, agent in enumerate(batch.possible_agents):
            lost += int(labs.illegal(number).sum()) if number == labs.manager.index else 0
            unsound += int((~np.isfinite(rewards[agent])).sum() + (~np.isfinite(infos[agent]["cost"])).sum())
        if rounds % 64 == 0:
            batch.weigh(everyone)
        if not warm and ended >= 0.2 * episodes:
            warm = resident_mib()
    elapsed = time.perf_counter() - begun
    figures |= {
        "episodes": ended,
        "limits_reached": batch.limits,
        "rounds": rounds,
        "agent_steps": turns,
        "lost_manager_turns": lost,
        "seconds": round(elapsed, 2),
        "episodes_per_s": round(ended / elapsed, 1),
        "agent_steps_per_s": round(turns / elapsed),
        "atoms_drift": batch.drift,
        "charge": batch.charge,
        "numbers_outside_0_1": outside,
        "rewards_not_finite": unsound,
        "amounts_not_sound": batch.negative,
        "safety_events": dict(zip(SAFETY_EVENTS, batch.events.round(3).tolist(), strict=True)),
        "memory_mib": round(warm, 1),
        "memory_growth_mib": round(resident_mib() - warm, 2),
    }
    figures["broken"] = broken(figures)
    return figures


def broken(figures: dict[str, Any]) -> list[str]:
    """Return the names of figures out of bounds."""
    bounds = {
        "atoms_drift": LARGEST_DRIFT,
        "charge": LARGEST_DRIFT,
        "numbers_outside_0_1": 0,
        "rewards_not_finite": 0,
        "amounts_not_sound": 0,
        "memory_growth_mib": LARGEST_GROWTH_MIB,
    }
    return [name for name, bound in bounds.items() if not figures[name] <= bound]


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", nargs="*", default=scenario_names(), help="scenarios to play (default: all)")
    parser.add_argument("--episodes", type=int, default=10_000, help="of each scenario")
    parser.add_argument("--members", type=int, default=256, help="laboratories in a batch")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    results = []
    for scenario in arguments.scenarios:
        results.append(soak(scenario, arguments.episodes, arguments.members, arguments.seed))
        print(json.dumps(results[-1]), file=sys.stderr, flush=True)
    print(json.dumps(results, indent=2))
    sys.exit(any(result["broken"] for result in results))


if __name__ == "__main__":
    main()
