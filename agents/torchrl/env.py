"""N laboratories as one TorchRL environment with one agent group per role and the true state for a central critic.

>>> from chemlab.agents.torchrl.env import TorchLaboratory
>>> env = TorchLaboratory(64, "wurtz_dodecane", actions="discrete")                # doctest: +SKIP
>>> env.rollout(20)["rxn", "observation"].shape                                    # doctest: +SKIP
torch.Size([64, 20, 1, 214])

A step is one round of :class:`~chemlab.envs.batch.BatchedLaboratory`: a manager action if the manager has the turn,
else one tick. Entries for N laboratories, A agents of the group and n actions:

| entry | shape | description |
|---|---|---|
| `(group, "observation")` | [N, A, size] | in [0, 1] |
| `(group, "action_mask")` | [N, A, n] | legal discrete actions; without the turn only one, a no-op |
| `(group, "has_turn")` | [N, A] | true if the agent's action is played in this step |
| `(group, "reward")` | [N, A, 1] | |
| `(group, "info", ...)` | [N, A] | `cost`, `score`, `experiment_over`, `illegal_action`, `elapsed_ticks` |
| `"state"` | [N, S] | true state (:mod:`chemlab.envs.global_state`), in [0, 1] |
| `"done"`, `"terminated"`, `"truncated"` | [N, 1] | end of the episode, common to all agents |

Needs TorchRL, after PyTorch: ``pip install torch``, then ``pip install ".[torchrl]"``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from typing_extensions import Unpack

from chemlab.config.scenario import Scenario, Settings
from chemlab.envs.batch import BatchedLaboratory
from chemlab.kernels.rng import checked_seed

from ..background import background_players
from ..roles import chosen_roles, role_of

try:
    import torch
    from tensordict import TensorDict, TensorDictBase
    from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
    from torchrl.envs import EnvBase
except ImportError as error:
    raise ImportError(
        f'chemlab.agents.torchrl needs TorchRL ({error}): pip install torch, then pip install ".[torchrl]"'
    ) from error

_INFOS: dict[str, Any] = {
    "cost": torch.float32,
    "score": torch.float32,
    "experiment_over": torch.bool,
    "illegal_action": torch.bool,
    "elapsed_ticks": torch.int64,
}


class TorchLaboratory(EnvBase):
    """N laboratories as a TorchRL environment; see this module's documentation.

    Args:
        num_envs: number of laboratories N.
        scenario: a shipped name, a path to a TOML file, or a loaded scenario.
        roles: learning roles; None: all. The environment plays the others.
        background: policies of the other roles, by name (see :func:`~chemlab.agents.policies.make_policies`).
        state: True adds the true state to every step.
        seed: seed of the first episodes; laboratory i has seed + i.
        device: device of the returned tensors.
        settings: ``rewards``, ``split`` and ``actions`` (:meth:`~chemlab.config.scenario.Scenario.configured`).

    Raises:
        DataError: the scenario is invalid or unknown.
        ValueError: ``num_envs`` is below 1, or a role or policy is unknown.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Path | Scenario = "wurtz_dodecane",
        roles: Sequence[str] | None = None,
        background: str = "scripted",
        state: bool = True,
        seed: int | None = None,
        device: Any = "cpu",
        **settings: Unpack[Settings],
    ) -> None:
        self._batch = batch = BatchedLaboratory(num_envs, scenario, copy=False, autoreset=False, **settings)
        super().__init__(device=device, batch_size=torch.Size([num_envs]))
        self.scenario = batch.scenario
        labs = batch.laboratories
        learning = chosen_roles(labs, roles)
        self._players = background_players(labs, learning, background)
        self._learning = [number for number, agent in enumerate(labs.agents) if role_of(agent) in learning]
        self._others = [number for number in range(len(labs.agents)) if number not in self._learning]
        self.group_map = {role: [agent for agent in labs.agents if role_of(agent) == role] for role in learning}
        self._state = np.empty((num_envs, *batch.state_space.shape), dtype=np.float32) if state else None
        self._make_specs()
        self._first_seed: int | None = None
        if seed is not None:
            self.set_seed(seed)

    def _make_specs(self) -> None:
        n, device = self._batch.num_envs, self.device
        observations, actions, rewards = (Composite(shape=(n,), device=device) for _ in range(3))
        for group, agents in self.group_map.items():
            lead = (n, len(agents))
            seen, space = self._batch.observation_space(agents[0]), self._batch.action_space(agents[0])
            entries: dict[str, Any] = {
                "observation": Bounded(0.0, 1.0, (*lead, *seen.shape), device, torch.float32),
                "has_turn": Categorical(2, shape=lead, device=device, dtype=torch.bool),
                "info": Composite(
                    {name: Unbounded(lead, device=device, dtype=kind) for name, kind in _INFOS.items()},
                    shape=lead,
                    device=device,
                ),
            }
            if isinstance(space, gymnasium.spaces.Discrete):
                count = int(space.n)
                entries["action_mask"] = Binary(shape=(*lead, count), device=device, dtype=torch.bool)
                action: Any = Categorical(count, shape=lead, device=device, dtype=torch.int64)
            else:
                action = Bounded(0.0, 1.0, (*lead, *(space.shape or ())), device, torch.float32)
            observations[group] = Composite(entries, shape=lead, device=device)
            actions[group] = Composite({"action": action}, shape=lead, device=device)
            rewards[group] = Composite(
                {"reward": Unbounded((*lead, 1), device=device, dtype=torch.float32)}, shape=lead, device=device
            )
        if self._state is not None:
            size = self._batch.state_space.shape
            observations["state"] = Bounded(0.0, 1.0, (n, *size), device, torch.float32)
        ends = ("done", "terminated", "truncated")
        self.observation_spec, self.action_spec, self.reward_spec = observations, actions, rewards
        self.done_spec = Composite(
            {name: Categorical(2, shape=(n, 1), device=device, dtype=torch.bool) for name in ends},
            shape=(n,),
            device=device,
        )

    def _set_seed(self, seed: int | None) -> None:
        self._first_seed = checked_seed(seed)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        """Start new episodes where ``_reset`` is true; in all laboratories without ``_reset`` or after a seed."""
        options: dict[str, Any] = {}
        if tensordict is not None and "_reset" in tensordict and self._first_seed is None:
            options["reset_mask"] = tensordict["_reset"].reshape(-1).cpu().numpy()
        observations, infos = self._batch.reset(seed=self._first_seed, options=options)
        if self._first_seed is not None:
            for member in range(self._batch.num_envs):
                self._players.seed(member, self._first_seed + member)
        self._first_seed = None
        begun = np.flatnonzero(options["reset_mask"]) if options else Ellipsis
        self._players.renew(self._batch.laboratories.members[begun])
        entries = {**self._entries(observations, infos, begun), **self._ended()}
        return TensorDict(entries, batch_size=self.batch_size, device=self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        given = {
            agent: actions[:, i]
            for group, agents in self.group_map.items()
            for actions in [tensordict[group, "action"].cpu().numpy()]
            for i, agent in enumerate(agents)
        }
        observations, rewards, terminated, truncated, infos = self._batch.step({**given, **self._played(given)})
        entries = self._entries(observations, infos)
        for group, agents in self.group_map.items():
            earned = np.stack([rewards[agent] for agent in agents], axis=1)[..., None]
            entries[group]["reward"] = self._tensor(earned, torch.float32)
        ended = self._ended(terminated, truncated)
        return TensorDict({**entries, **ended}, batch_size=self.batch_size, device=self.device)

    def _played(self, given: dict[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
        """Return the actions [N, ...] of background agents that have the turn in any laboratory, beside ``given``."""
        labs, played = self._batch.laboratories, dict[str, npt.NDArray[Any]]()
        if not self._others:
            return played
        self._batch.checked(given, self._learning)  # first: background policies may draw, or remember
        turns, actions = labs.turns(labs.members), labs.no_actions()
        for number in self._others:
            who = labs.members[turns[number]]
            if len(who):
                actions[number][who] = self._players.decide(number, who)
                played[labs.agents[number]] = actions[number]
        return played

    def _entries(
        self, observations: Mapping[str, Any], infos: Mapping[str, Mapping[str, Any]], begun: Any = Ellipsis
    ) -> dict[str, Any]:
        """Return the entries of groups and critic after a step, or after a reset of the laboratories in ``begun``."""
        result: dict[str, Any] = {}
        for group, agents in self.group_map.items():
            entries: dict[str, Any] = {
                "observation": self._stacked([observations[agent] for agent in agents], torch.float32),
                "has_turn": self._stacked([infos[agent]["has_turn"] for agent in agents], torch.bool),
                "info": TensorDict(
                    {
                        name: self._stacked([infos[agent][name] for agent in agents], kind)
                        for name, kind in _INFOS.items()
                    },
                    batch_size=(self._batch.num_envs, len(agents)),
                    device=self.device,
                ),
            }
            if "action_mask" in infos[agents[0]]:
                entries["action_mask"] = self._stacked([infos[agent]["action_mask"] for agent in agents], torch.bool)
            result[group] = TensorDict(entries, batch_size=(self._batch.num_envs, len(agents)), device=self.device)
        if self._state is not None:
            self._state[begun] = self._batch.state(begun)
            result["state"] = self._tensor(self._state.copy(), torch.float32)
        return result

    def rand_action(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        """Sample random actions; legal ones if ``tensordict`` has masks."""
        drawn: TensorDictBase = super().rand_action(tensordict)
        for group in self.group_map:
            mask = None if tensordict is None else tensordict.get((group, "action_mask"), None)
            if mask is not None:
                choices = torch.multinomial(mask.flatten(0, -2).to(torch.float32), 1)
                drawn[group, "action"] = choices.reshape(mask.shape[:-1])
        return drawn

    def _ended(
        self, terminated: npt.NDArray[np.bool_] | None = None, truncated: npt.NDArray[np.bool_] | None = None
    ) -> dict[str, Any]:
        nobody = np.zeros(self._batch.num_envs, dtype=np.bool_)
        terminated, truncated = (nobody if which is None else which for which in (terminated, truncated))
        ends = {"done": terminated | truncated, "terminated": terminated, "truncated": truncated}
        return {name: self._tensor(values[:, None], torch.bool) for name, values in ends.items()}

    def _stacked(self, arrays: Sequence[npt.NDArray[Any]], kind: Any) -> Any:
        """Stack the group's arrays [N, ...] to [N, A, ...] as a copy, because the batch reuses its arrays."""
        return self._tensor(np.stack(arrays, axis=1), kind)

    def _tensor(self, values: npt.NDArray[Any], kind: Any) -> Any:
        return torch.from_numpy(np.ascontiguousarray(values)).to(device=self.device, dtype=kind)
