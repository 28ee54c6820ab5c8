"""Export of a training run's best checkpoint as a policy that needs only NumPy, compared with the original.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

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
"""Largest accepted difference between the outputs of the original and the exported policy."""


def _outputs(model: Any, observation: ObservationArray) -> npt.NDArray[Any]:
    """Return SB3's outputs for observations: Q values, log-probabilities, means, or (SAC, TD3) actions."""
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
    """Return observations of random episodes; ``advised``: with the played action as the hint."""
    env = task.batch(64)
    policy = RandomPolicy(action_size(env.single_action_space), 0)
    step, members = np.zeros(64, dtype=np.int64), np.arange(64)
    observations, infos = env.reset(seed=0)
    seen = []
    for _ in range(21):
        actions = policy.act(observations, infos.get("action_mask"), step, members)
        seen.append(with_advice(observations, actions, env.action_count) if advised else observations)
        observations, _, _, _, infos = env.step(actions)
    return np.concatenate(seen)


def largest_difference(model: Any, policy: PretrainedPolicy, observation: ObservationArray) -> float:
    """Return the largest difference between the outputs of both policies, relative for outputs above 1.

    Actions are compared, and the quantities that determine them: Q values, log-probabilities, unclipped means. Infinite
    if the discrete actions differ without a tie.
    """
    if policy.card.memory:
        return _largest_in_sequence(model, policy, observation)
    theirs, ours = _outputs(model, observation), policy.values(observation)
    zeros = np.zeros(len(observation), dtype=np.int64)
    played = np.asarray(model.predict(observation, deterministic=True)[0])
    actions = policy.act(observation, None, zeros, zeros)
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
    """Return :func:`largest_difference` of policies with a memory, by their actions."""
    original, member, largest = as_policy(model), np.zeros(1, dtype=np.int64), 0.0
    legal = np.ones((1, policy.card.action_size), dtype=np.int8) if policy.card.output == "argmax" else None
    for i, seen in enumerate(observation):
        theirs, ours = (one.act(seen[None], legal, member + i, member) for one in (original, policy))
        if policy.card.output == "argmax" and (theirs != ours).any():
            return float("inf")
        largest = max(largest, _relative(ours, theirs))
    return largest


def _relative(ours: npt.NDArray[Any], theirs: npt.NDArray[Any]) -> float:
    return float((np.abs(ours - theirs) / np.maximum(1.0, np.abs(theirs))).max())


def export_run(folder: Path, out: Path, role: str | None = None) -> Card:
    """Write ``OUT.safetensors`` and ``OUT.json`` from a run's best checkpoint.

    Args:
        folder: the run's folder. With ``:greedy`` or ``:sampled`` after it, the exported policy plays in this way;
            otherwise in that of the checkpoint's evaluation.
        out: path of the two files, with or without a suffix; the file name is the policy's name.
        role: role to export, if several were trained together. A bench is then evaluated on its own, on vessels of
            laboratories.

    Raises:
        ValueError: the folder has no run or no checkpoint, its bench has changed since, the role is missing or unknown,
            or the exported policy differs from SB3's by more than 1e-5 (compared for the user's own runs, or if
            untrusted code is allowed).
    """
    name, way = split_way(str(folder))
    run = Run(Path(name))
    config, best = run.config(), run.checkpoint("best")
    if config is None:
        raise ValueError(f"{folder}: contains no training run (no config.json)")
    if best is None:
        raise ValueError(
            f"{folder}: contains no checkpoint (not under version control); train again with another --out, or delete "
            "the folder first, because a finished run is not repeated"
        )
    arguments = recorded_arguments(config, str(run.config_file))
    learned = sorted(file.stem for file in best.glob("*.safetensors"))
    if not learned:
        raise ValueError(f"{folder}: was trained by a version with other learners; train it again")
    if isinstance(arguments, Single):
        if role is not None:
            raise ValueError(f"role: {folder}: is a run of one role: give none; given {role!r}")
        task, trained = find_task(arguments), config["fingerprint"]
    else:
        role = learned[0] if role is None and len(learned) == 1 else role
        if role not in learned:
            raise ValueError(f"role: {folder}: give one of its roles: {', '.join(learned)}; given {role!r}")
        card = load_pretrained(best / str(role)).card
        splits = arguments.split, arguments.evaluation_split
        task, trained = task_of(card, load_scenario(arguments.scenario), splits), card.fingerprint
    if trained != task.fingerprint:
        raise ValueError(f"{folder}: {task.agent} of {task.scenario.name} has changed since this run; train it again")
    policy = load_pretrained(best / task.workplace.key)
    policy.check(task.workplace)
    if isinstance(arguments, Single):
        _compare(folder, best, str(config["algo"]), task, policy)
    # The exported policy is played with masks, even if it was trained without them.
    path = out.with_suffix("") if out.suffix in (".json", ".safetensors") else out
    card = policy.card.model_copy(update={"name": path.name, "masked": True})
    policy = PretrainedPolicy(card, policy.weights).as_played(way)
    episodes = arguments.final_episodes
    by_goal = task.by_goal(task.trained(policy), episodes, RESULT_SEED)
    scripted = task.scripted(episodes, RESULT_SEED)
    evaluation = {
        "episodes_per_goal": episodes,
        "seed": RESULT_SEED,
        "mean": sum(by_goal.values()) / len(by_goal),
        "by_goal": by_goal,
        "scripted_mean": sum(scripted.values()) / len(scripted) if scripted else None,
        "scripted_by_goal": scripted,
    }
    card = policy.card.model_copy(update={"evaluation": evaluation})
    save_policy(path, card, policy.weights)
    return card


def _compare(folder: Path, checkpoint: Path, algo: str, task: Task, policy: PretrainedPolicy) -> None:
    """Raise ValueError if a policy differs from its learner; the learner of an untrusted run is not loaded."""
    try:
        model = load_learner(checkpoint, algo)
    except DataError:
        return
    difference = largest_difference(
        model, policy.as_played(GREEDY), _observations(task, policy.card.advice is not None)
    )
    if not difference <= _TOLERANCE:
        raise ValueError(
            f"{folder}: the exported policy differs from SB3's by {difference:.2g} (allowed: {_TOLERANCE:g})"
        )
