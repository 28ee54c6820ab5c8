"""Export of a training run's best checkpoint as a policy that needs only NumPy, with a check of equality.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from chemlab.config.datafile import DataError
from chemlab.config.extras import needs
from chemlab.config.loading import load_scenario
from chemlab.envs.players import as_policy
from chemlab.kernels.arrays import ObservationArray

from ..advice import with_advice
from ..former_names import GREEDY, split_way
from ..pretrained import Card, PretrainedPolicy, load_pretrained, save_policy
from ..random_policy import RandomPolicy
from ..roles import action_size
from ..runs import RESULT_SEED, Run
from .arguments import Single, recorded_arguments
from .tasks import Task, find_task, task_of

with needs("exporting needs PyTorch", "train"):
    import torch

    from ..learners import load_learner


_TOLERANCE = 1e-5


def _outputs(model: Any, observation: ObservationArray) -> npt.NDArray[Any]:
    """Return the outputs of SB3's own code for observations: Q values, log-probabilities, means, or (off policy)
    actions.
    """
    if hasattr(model.policy, "actor"):
        return np.asarray(model.predict(observation, deterministic=True)[0])
    with torch.no_grad():
        seen, _ = model.policy.obs_to_tensor(observation)
        if hasattr(model.policy, "q_net"):
            return np.asarray(model.policy.q_net(seen).numpy())
        if hasattr(model.policy, "quantile_net"):
            return np.asarray(model.policy.quantile_net(seen).mean(dim=1).numpy())
        distribution = model.policy.get_distribution(seen).distribution
        discrete = isinstance(model.action_space, gymnasium.spaces.Discrete)
        return np.asarray((distribution.logits if discrete else distribution.mean).numpy())


def _observations(task: Task, advised: bool) -> ObservationArray:
    """Return observations of random episodes, with the played action as the hint if there is one."""
    members = 64
    env = task.batch(members)
    policy = RandomPolicy(action_size(env.single_action_space), 0)
    nothing, everyone = np.zeros(members, dtype=np.int64), np.arange(members)
    observations, infos = env.reset(seed=0)
    seen = []
    for _ in range(21):
        actions = policy.act(observations, infos.get("action_mask"), nothing, everyone)
        seen.append(with_advice(observations, actions, env.action_count) if advised else observations)
        observations, _, _, _, infos = env.step(actions)
    return np.concatenate(seen)


def largest_difference(model: Any, policy: PretrainedPolicy, observation: ObservationArray) -> float:
    """Return the largest difference between the outputs of both policies, relative for outputs above 1.

    Actions are compared, and the quantities that determine them: Q values, log-probabilities, unclipped means. Infinite
    if another discrete action is chosen without a tie.
    """
    if policy.card.memory:
        return _largest_in_sequence(model, policy, observation)
    theirs, ours = _outputs(model, observation), policy.values(observation)
    nothing = np.zeros(len(observation), dtype=np.int64)
    played = np.asarray(model.predict(observation, deterministic=True)[0])
    actions = policy.act(observation, None, nothing, nothing)
    if policy.card.output == "argmax":
        if not (hasattr(model.policy, "q_net") or hasattr(model.policy, "quantile_net")):
            highest = ours.max(axis=1, keepdims=True)
            ours = ours - highest - np.log(np.exp(ours - highest).sum(axis=1, keepdims=True))
        rows = np.arange(len(played))
        if _relative(theirs[rows, actions], theirs[rows, played]) > _TOLERANCE:
            return float("inf")
        return _relative(ours, theirs)
    return max(_relative(actions, played), _relative(ours, theirs) if policy.card.output == "clip" else 0.0)


def _largest_in_sequence(model: Any, policy: PretrainedPolicy, observation: ObservationArray) -> float:
    """Return the same for policies with a memory, on sequences of observations."""
    original, nobody, worst = as_policy(model), np.zeros(1, dtype=np.int64), 0.0
    legal = np.ones((1, policy.card.action_size), dtype=np.int8) if policy.card.output == "argmax" else None
    for i, seen in enumerate(observation):
        theirs, ours = (one.act(seen[None], legal, nobody + i, nobody) for one in (original, policy))
        if policy.card.output == "argmax" and (theirs != ours).any():
            return float("inf")
        worst = max(worst, _relative(ours, theirs))
    return worst


def _relative(ours: npt.NDArray[Any], theirs: npt.NDArray[Any]) -> float:
    return float((np.abs(ours - theirs) / np.maximum(1.0, np.abs(theirs))).max())


def export_run(folder: Path, out: Path, role: str | None = None) -> Card:
    """Write ``OUT.safetensors`` and ``OUT.json`` from a run's best checkpoint.

    Args:
        folder: the run; ``:greedy`` or ``:sampled`` after it says how the exported policy plays, instead of the way in
            which the checkpoint was evaluated.
        out: path of the two files, with or without a suffix; the file name is the policy's name.
        role: role, if several were trained together. A bench is then evaluated on its own, with a laboratory's vessels.

    Raises:
        ValueError: the folder holds no run or no checkpoint, its bench has changed since, the role is missing or
            unknown, or the exported policy differs from SB3's by more than 1e-5 (checked for the user's own runs, or
            with untrusted code allowed).
    """
    name, way = split_way(str(folder))
    run = Run(Path(name))
    config, best = run.config(), run.checkpoint("best")
    if config is None:
        raise ValueError(f"{folder}: contains no training run (no config.json)")
    if best is None:
        raise ValueError(f"{folder}: contains no checkpoint (not under version control); run chemlab train again")
    arguments = recorded_arguments(config, str(run.config_file))
    team, learned = not isinstance(arguments, Single), sorted(file.stem for file in best.glob("*.safetensors"))
    if not learned:
        raise ValueError(f"{folder}: was trained by a version with other learners; train it again")
    if team and role is None and len(learned) == 1:
        role = learned[0]
    if team != (role is not None) or (role is not None and role not in learned):
        known = f"give one of its roles: {', '.join(learned)}"
        raise ValueError(f"role: {folder}: {known if team else 'is a run of one role: give none'}; given {role!r}")
    if isinstance(arguments, Single):
        task, trained = find_task(arguments), config["fingerprint"]
    else:
        card = load_pretrained(best / str(role)).card
        splits = arguments.split, arguments.evaluation_split
        task, trained = task_of(card, load_scenario(arguments.scenario), splits), card.fingerprint
    if trained != task.fingerprint:
        raise ValueError(f"{folder}: {task.agent} of {task.scenario.name} has changed since this run; train it again")
    policy, model = load_pretrained(best / task.workplace.key), None
    policy.check(task.workplace)
    if not team:
        with suppress(DataError):  # the weights of an untrusted run are exported without a comparison
            model = load_learner(best, str(config["algo"]))
    if model is not None:
        difference = largest_difference(
            model, policy.as_played(GREEDY), _observations(task, policy.card.advice is not None)
        )
        if not difference <= _TOLERANCE:
            raise ValueError(
                f"{folder}: the exported policy differs from SB3's by {difference:.2g} (allowed: {_TOLERANCE:g})"
            )
    # The exported policy is played with masks, however it was trained.
    path = out.with_suffix("") if out.suffix in (".json", ".safetensors") else out
    policy = PretrainedPolicy(
        policy.card.model_copy(update={"name": path.name, "masked": True}), policy.weights
    ).as_played(way)
    episodes = arguments.final_episodes
    found = task.by_goal(task.trained(policy), episodes, RESULT_SEED)
    scripted = task.scripted(episodes, RESULT_SEED)
    evaluation = {
        "episodes_per_goal": episodes,
        "seed": RESULT_SEED,
        "mean": sum(found.values()) / len(found),
        "by_goal": found,
        "scripted_mean": sum(scripted.values()) / len(scripted) if scripted else None,
        "scripted_by_goal": scripted,
    }
    card = policy.card.model_copy(update={"evaluation": evaluation})
    save_policy(path, card, policy.weights)
    return card
