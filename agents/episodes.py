"""Play episodes of a bench or a laboratory: in a batch, or one with a callback for each turn and a record."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.envs.aec import raw_env
from chemlab.envs.inputs import parsed_seeds
from chemlab.envs.players import Players, Policy
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.kernels.arrays import FloatArray, IntArray
from chemlab.lab.engine import Laboratories
from chemlab.record import Play, Recorder
from chemlab.roles.manager_state import COST_ITEMS, COST_WORDS, LIMIT, STATUS_WORDS

_TRACE_MOL = 1e-6
"""Smallest amount of a material that counts as present."""
_TRACE_EVENT = 1e-9
"""Smallest total of a safety event; less is a rounding error."""


@dataclass
class Played:
    """Results of n episodes of a policy for one goal.

    Attributes:
        returns: [n] return of the bench's agent, or the manager's score of a laboratory.
        lengths: [n] steps taken (a laboratory: ticks).
        cost: [n] weighted safety events.
        illegal: [n] invalid actions.
        cases: [n] kind of initial state; '' if there is only one.
        measures: further measures, {name: [n]}.
        actions: actions of each episode (integers, or lists of numbers), if they were recorded.
    """

    returns: FloatArray
    lengths: IntArray
    cost: FloatArray
    illegal: IntArray
    cases: list[str]
    measures: dict[str, FloatArray]
    actions: list[list[Any]] | None = None

    @classmethod
    def joined(cls, parts: Sequence[Played]) -> Played:
        """Return several batches as one."""
        arrays = ("returns", "lengths", "cost", "illegal")
        recorded = [part.actions for part in parts if part.actions is not None]
        return cls(
            **{name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays},
            cases=[case for part in parts for case in part.cases],
            measures={name: np.concatenate([part.measures[name] for part in parts]) for name in parts[0].measures},
            actions=[actions for part in recorded for actions in part] if recorded else None,
        )


def _case(env: RoleVectorEnv, goal: str, member: int) -> str:
    """Return the random companion of the initial state; '' if it is not random."""
    companion = env.bench.spec.start.companion
    if companion is None or companion.probability in (0.0, 1.0):
        return ""
    other = companion.if_goal if goal == companion.material else companion.material
    salts = [salt for salt in env.batch.scenario.family.salt if salt.solid == other]
    forms = {other, *(ion for salt in salts for ion in (salt.cation, salt.anion))}
    present = forms & env.batch.shelf.vessel(member, 0).amounts(_TRACE_MOL).keys()
    return f"{'with' if present else 'without'} {other}"


def play_bench(
    env: RoleVectorEnv,
    policy: Policy,
    goal: str | Sequence[str],
    seed: int | Sequence[int],
    record: bool = False,
) -> Played:
    """Play one experiment in each of N environments; each gives the same result as a single one with its seed.

    Args:
        env: batch of N with ``autoreset_mode="SameStep"``.
        policy: policy of all environments.
        goal: goal of the experiments, or one for each environment.
        seed: seed of environment 0 (the others have consecutive seeds), or one for each environment. Random policies
            are seeded with them as well.
        record: True to keep the actions.

    Returns:
        N episodes.
    """
    n, limit = env.num_envs, env.bench.spec.step_limit
    goals = np.array([goal] * n if isinstance(goal, str) else goal)
    seeds = parsed_seeds(seed, n)
    for i, name in enumerate(dict.fromkeys(goals.tolist())):
        # The first reset must include all environments; those with other goals are then reset again.
        reset = goals == name if i else np.ones(n, dtype=np.bool_)
        observations, _ = env.reset(seed=seeds, options={"goal": name, "reset_mask": reset})
    cases = [_case(env, name, member) for member, name in enumerate(goals.tolist())]
    if hasattr(policy, "seed"):
        for member, own_seed in enumerate(seeds):
            policy.seed(member, own_seed)
    played = Played(np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(n, dtype=np.int64), cases, {}, None)
    running, step, members = np.ones(n, dtype=np.bool_), np.zeros(n, dtype=np.int64), np.arange(n)
    rows: list[npt.NDArray[Any]] = []
    for _ in range(limit):
        mask = env.action_masks().astype(np.int8) if env.bench.action_count else None
        actions = policy.act(observations, mask, step, members)
        if record:
            rows.append(np.array(actions))
        observations, rewards, terminated, truncated, infos = env.step(actions)
        played.returns += running * rewards
        played.cost += running * infos["cost"]
        played.illegal += running * infos["illegal_action"]
        played.lengths += running
        ended = terminated | truncated
        # An environment whose episode has ended plays another one, which is not counted; step 0 resets the memory.
        step = np.where(ended, 0, step + 1)
        running &= ~ended
        if not running.any():
            break
    if record:
        played.actions = [[row[i].tolist() for row in rows[: int(length)]] for i, length in enumerate(played.lengths)]
    return played


def _in_order(policies: Mapping[str, Policy], agents: Sequence[str]) -> list[Policy]:
    """Return the policies in the order of the agents; raise ValueError for other keys, such as roles (``rxn``)."""
    if set(policies) != set(agents):
        given = ", ".join(map(str, policies)) or "none"
        raise ValueError(f"policies: needs one for each of {', '.join(agents)}, given {given}")
    return [policies[agent] for agent in agents]


def play_laboratory(labs: Laboratories, policies: Mapping[str, Policy], goal: str | None, seed: int) -> Played:
    """Play one episode in each of N laboratories; laboratory i plays as :func:`play_episode` does with seed + i.

    Args:
        labs: N laboratories.
        policies: policy of every agent, by its name.
        goal: goal of all orders; None: drawn in each episode.
        seed: seed of laboratory 0. Random policies are seeded with the laboratories' seeds as well.

    Returns:
        N episodes with the manager's scores. The measures are ``submitted_mol``, ``purity`` (0 if nothing was
        submitted), ``instruments`` (cost of measurements, in units of the score), ``manager_actions``, ``unsafe`` (1 if
        anything was spilled or vented, or a metal burned), ``limit`` (1 if actions or ticks ran out), ``nothing`` (1 if
        nothing was submitted), and ``reward AGENT``, the return of each bench agent.
    """
    n, ordered = len(labs.members), _in_order(policies, labs.agents)
    labs.begin(seed, goal)
    cost, illegal, rewards = np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros((n, len(labs.agents)))

    def count(number: int, members: IntArray) -> None:
        rewards[members] += labs.rewards[members]
        cost[members] += labs.cost[members].sum(axis=1)
        illegal[members] += labs.roles[number].illegal[members]

    players = Players(labs, ordered)
    for member in labs.members.tolist():
        players.seed(member, seed + member)
    players.play_on(labs.members, count)
    mol, purity = labs.state.submitted[:, :, 0], labs.state.submitted[:, :, 1]
    total = mol.sum(axis=1)
    harmful = [kind not in ("boiled_dry", "dry_heating") for kind in labs.scenario.safety_events]
    measures = {
        "submitted_mol": total,
        "purity": np.divide((mol * purity).sum(axis=1), total, out=np.zeros(n), where=total > 0.0),
        "instruments": labs.state.charges[:, COST_ITEMS.index("instruments")].copy(),
        "manager_actions": labs.state.actions.astype(np.float64),
        "unsafe": (labs.safety_totals[:, harmful] >= _TRACE_EVENT).any(axis=1).astype(np.float64),
        "limit": (labs.state.status == LIMIT).astype(np.float64),
        "nothing": (total == 0.0).astype(np.float64),
    }
    measures |= {f"reward {role.name}": rewards[:, role.index] for role in labs.bench_roles}
    return Played(labs.result(labs.members), labs.state.ticks.copy(), cost, illegal, [""] * n, measures)


@dataclass(frozen=True)
class PlayedTurn:
    """A turn that an agent has just played."""

    agent: str
    tick: int
    action: Any
    reward: float
    info: Mapping[str, Any]


@dataclass
class EpisodeResult:
    """Results of an episode; ``chemlab run --json`` prints its fields.

    ``score`` is the raw score: the mean payment of the orders, minus ``missed`` (the penalty for orders that pay
    nothing) and minus costs. ``paid`` is the number of orders that pay something. ``status`` is the reason for the
    episode's end (:data:`~chemlab.roles.manager_state.STATUS_WORDS`).
    """

    scenario: str
    policy: str
    seed: int
    goal: str
    orders: int
    paid: int
    submitted_mol: float
    purity: float
    score: float
    manager_actions: int
    ticks: int
    rewards: dict[str, float]
    missed: float
    costs: dict[str, float]
    safety_events: dict[str, float]
    status: str

    def words(self) -> str:
        """Return a line with the outcome, the costs and the score."""
        items = (*COST_WORDS, "missed orders" if self.orders > 1 else "missed order")
        charged = zip(items, (*self.costs.values(), self.missed), strict=True)
        costs = ", ".join(f"{item} {value:.4f}" for item, value in charged if value > 0.0)
        end = f"submitted {self.submitted_mol:.3f} mol {self.goal} at purity {self.purity:.3f}"
        if self.orders > 1:
            end = f"{self.paid} of {self.orders} orders paid; {end}"
        if self.status == STATUS_WORDS[LIMIT]:
            end = f"ran out of actions or ticks; {end if self.submitted_mol > 0.0 else 'nothing submitted'}"
        return f"{end}; costs: {costs or 'none'}; score {self.score:.3f}"


def play_episode(
    env: raw_env,
    policies: Mapping[str, Policy],
    seed: int,
    policy_name: str = "",
    watch: Callable[[PlayedTurn], None] | None = None,
    options: dict[str, Any] | None = None,
    recorder: Recorder | None = None,
) -> EpisodeResult:
    """Play one episode.

    Args:
        env: the laboratory, without wrappers.
        policies: a policy for every agent.
        seed: seed of the episode and of random policies.
        policy_name: name of the policies in the result.
        watch: called after every turn.
        options: passed to ``env.reset``.
        recorder: writes the episode's record.

    Returns:
        The episode's result.
    """
    ordered = _in_order(policies, env.possible_agents)
    env.reset(seed=seed, options=options)
    if recorder is not None:
        recorder.begin(seed, options)
    labs, rewards = env.laboratories, dict.fromkeys(env.possible_agents, 0.0)

    def act(number: int, members: IntArray, actions: npt.NDArray[Any]) -> None:
        agent, action = labs.agents[number], actions[0]
        tick = int(labs.state.ticks[0])
        seen, mask = labs.observe(number, members), labs.mask(number, members)
        env.step(action)
        if recorder is not None:
            recorder.turn([Play(number, seen[0], None if mask is None else mask[0], action)])
        for name, reward in env.rewards.items():
            rewards[name] += reward
        if watch is not None:
            watch(PlayedTurn(agent, tick, action, env.rewards[agent], env.infos[agent]))

    players = Players(labs, ordered, act)
    players.seed(0, seed)
    players.play_on(labs.members)
    outcome, state = labs.outcome(), labs.state
    totals = zip(labs.scenario.safety_events, labs.safety_totals[0].tolist(), strict=True)
    return EpisodeResult(
        env.scenario.name,
        policy_name,
        seed,
        ", ".join(dict.fromkeys(env.scenario.goals[goal] for goal in state.goal[0])),
        state.goal.shape[1],
        int(np.count_nonzero(labs.worth(labs.members))),
        outcome["submitted_mol"],
        outcome["purity"],
        float(labs.result(labs.members)[0]),
        int(state.actions[0]),
        int(state.ticks[0]),
        rewards,
        float(labs.missed(labs.members)[0]),
        dict(zip(COST_ITEMS, state.charges[0].tolist(), strict=True)),
        {kind: value for kind, value in totals if value > 0.0},
        STATUS_WORDS[state.status[0]],
    )


def record_episode(
    path: str | Path,
    env: raw_env,
    policies: Mapping[str, Policy],
    seed: int,
    policy_name: str = "",
    options: dict[str, Any] | None = None,
    force: bool = False,
) -> EpisodeResult:
    """Play one episode as :func:`play_episode` does, and write its record to ``path``.

    An existing file is replaced only with ``force``. A given ``policy_name`` is recorded for every agent.
    """
    names = dict.fromkeys(env.possible_agents, policy_name) if policy_name else None
    with Recorder(path, env.laboratories, policies=names, force=force) as recorder:
        return play_episode(env, policies, seed, policy_name, options=options, recorder=recorder)
