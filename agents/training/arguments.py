"""What a training run is: one dataclass, its presets, TOML files and flags.

Later ones win: the field's default, the preset, the config file, flags. Fields that are None follow the algorithm:
Stable-Baselines3's defaults, and the paper's protocol where the paper says something (:func:`resolved`).

The paper's protocol: 10 environments; gather 256 steps in each, then update. PPO and A2C learn from those 2560 steps
alone (so A2C makes one gradient step from them). DQN, SAC and TD3 keep 1M steps and sample them: 256 gradient steps of
DQN after each 2560 steps, 128 of SAC and TD3, whose gradient steps are ten times as expensive. The paper does not say
how many there were. DQN's exploration falls from 1.0 to 0.01 within the first 30k steps.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

from chemlab.materials import read_toml

__all__ = [
    "ALGORITHMS",
    "PRESETS",
    "JointArguments",
    "Stage",
    "TrainArguments",
    "arguments_of",
    "curriculum_of",
    "flags_of",
    "folder_of",
    "label_of",
    "load_arguments",
    "load_joint_arguments",
    "merged",
    "resolved",
]

ALGORITHMS: tuple[str, ...] = ("ppo", "a2c", "dqn", "sac", "td3", "maskable-ppo")
"""What ``algo`` may be."""

ON_POLICY = ("ppo", "a2c", "maskable-ppo")

_MANAGER: dict[str, Any] = {
    "algo": "maskable-ppo",
    "steps": 400_000,
    "envs": 256,
    "rollout": 16,
    "batch_size": 256,
    "ent_coef": 0.01,
    "gamma": 1.0,
    "eval_episodes": 50,
}

PRESETS: dict[str, dict[str, Any]] = {
    "paper": {},
    "ppo-entropy": {"algo": "ppo", "ent_coef": 0.01},
    "manager": {**_MANAGER, "learning_rate": 3e-4, "imitate": "heuristic"},
    "manager-curriculum": {**_MANAGER, "learning_rate": 1e-3, "curriculum": ("backward",)},
    "ppo-xl": {"algo": "ppo", "envs": 32, "steps": 2_000_000},
    "sac-cool": {"algo": "sac", "ent_coef_start": 0.01},
}
"""Presets: the fields that differ from the defaults, which are the paper's protocol."""


_SHORT = {"manager": "chemlab/LabManager-v0"}
"""What people may call an environment for short."""


def _argument(default: Any, text: str) -> Any:
    return field(default=default, metadata={"help": text})


@dataclass(frozen=True)
class TrainArguments:
    """Everything that decides what a training run learns; ``chemlab train --help`` is made from this."""

    env_id: str = _argument(
        "chemlab/WurtzReaction-v0", "Environment to train in, as registered with Gymnasium; manager for short."
    )
    algo: str = _argument("ppo", f"Algorithm: {', '.join(ALGORITHMS)}.")
    preset: str = _argument("paper", f"Defaults to start from: {', '.join(PRESETS)}.")
    steps: int = _argument(1_000_000, "Steps in all environments together; rounded up to whole rollouts.")
    seed: int = _argument(0, "Seed of networks, exploration and environments.")
    scenario: str | None = _argument(
        None, "Scenario, for chemlab/Bench-v0 and the laboratory's views (others have their own)."
    )
    bench: str | None = _argument(
        None, "Bench of the scenario, for chemlab/Bench-v0; the agent, for chemlab/LabAgent-v0 (others have their own)."
    )
    background: str | None = _argument(
        None, "Who plays the other roles of a laboratory, by name. Default: heuristic, for the laboratory's views."
    )
    goals: tuple[str, ...] | None = _argument(None, "Goals to train for; repeat the option. Default: all.")
    starts: str = _argument(
        "paper", "Starting states: paper, lab (as vessels reach the bench in a laboratory), or both."
    )
    curriculum: tuple[str, ...] | None = _argument(
        None,
        "Curriculum of a laboratory's role: backward (from the last bench to the first), or stages 'STEP: BENCH=SHARE "
        "...': until that step such shares of the episodes begin with a vessel on its way to the bench, or to submit, "
        "the rest with the scenario's shelf; repeat the option. Default: none.",
    )
    imitate: str | None = _argument(
        None, "Policy to imitate before learning, by name (heuristic, hasty, ...). Default: none."
    )
    imitate_steps: int | None = _argument(None, "About how many of its turns. Default: 20000.")
    envs: int = _argument(10, "Environments side by side.")
    rollout: int = _argument(256, "Steps gathered in each environment before each update.")
    learning_rate: float | None = _argument(None, "Learning rate. Default: the algorithm's in SB3.")
    gamma: float | None = _argument(None, "Discount. Default: 0.99.")
    gae_lambda: float | None = _argument(None, "GAE lambda of PPO and A2C. Default: the algorithm's in SB3.")
    ent_coef: float | None = _argument(None, "Weight of the entropy. Default: 0 on policy, learned by SAC.")
    ent_coef_start: float | None = _argument(None, "What SAC's learned weight begins with. Default: 1.0, SB3's.")
    batch_size: int | None = _argument(None, "Minibatch of PPO and of replay. Default: the algorithm's in SB3.")
    epochs: int | None = _argument(None, "PPO's passes over a rollout. Default: 10.")
    clip_range: float | None = _argument(None, "PPO's clip range. Default: 0.2.")
    gradient_steps: int | None = _argument(
        None, "Gradient steps from replay after each rollout. Default: 256; SAC, TD3 128."
    )
    buffer_size: int | None = _argument(None, "Steps kept for replay. Default: 1000000.")
    learning_starts: int | None = _argument(None, "Random steps before learning from replay. Default: 100.")
    exploration_steps: int | None = _argument(
        None, "Steps in which DQN's exploration falls to its end. Default: 30000."
    )
    exploration_final: float | None = _argument(None, "DQN's exploration after that. Default: 0.01.")
    action_noise: float | None = _argument(None, "Standard deviation of TD3's exploration, of [-1, 1]. Default: 0.1.")
    net_arch: tuple[int, ...] | None = _argument(
        None, "Hidden layers; repeat the option. Default: the algorithm's in SB3."
    )
    evaluations: int = _argument(10, "Evaluations during training, evenly spread, beside the scripted policy.")
    eval_episodes: int = _argument(20, "Episodes a goal in each of them.")
    final_episodes: int = _argument(100, "Episodes a goal in the evaluation at the end.")
    checkpoints: int = _argument(
        40, "Checkpoints during training, evenly spread (a crash loses what is after the last)."
    )


@dataclass(frozen=True)
class JointArguments:
    """Everything that decides what a joint training run learns."""

    scenario: str = _argument("wurtz_dodecane", "Scenario: a shipped name or a path.")
    roles: tuple[str, ...] | None = _argument(
        None, "Roles that learn: manager and bench keys; repeat the option. Default: all."
    )
    background: str = _argument("heuristic", "Who plays the roles that do not learn, by name.")
    regime: str = _argument("together", "together, or in-turns (round-robin).")
    period: int = _argument(10, "Updates before the next role's turn (in-turns).")
    begin_from: str | None = _argument(
        None, "Where to start from: a joint run, a folder of runs by role, or ROLE=RUN,ROLE=RUN. Default: scratch."
    )
    rewards: str | None = _argument(None, "Another reward mix than the scenario's.")
    steps: int = _argument(1_000_000, "Turns of learning agents, all laboratories together.")
    envs: int = _argument(64, "Laboratories side by side.")
    rollout: int = _argument(64, "Rounds (a manager action, or a tick) before each update.")
    seed: int = _argument(0, "Seed of networks, exploration and laboratories.")
    gamma: float = _argument(0.99, "Discount a turn of a bench's agent.")
    manager_gamma: float = _argument(1.0, "Discount a decision of the manager.")
    by_ticks: bool = _argument(False, "Discount by elapsed ticks instead of turns.")
    gae_lambda: float = _argument(0.95, "GAE lambda.")
    learning_rate: float = _argument(3e-4, "Learning rate.")
    ent_coef: float = _argument(0.01, "Weight of the entropy of discrete actions.")
    batch_size: int = _argument(256, "Minibatch.")
    epochs: int = _argument(10, "PPO's passes over a rollout.")
    evaluations: int = _argument(10, "Evaluations during training, evenly spread.")
    eval_episodes: int = _argument(20, "Episodes a goal in each of them.")
    final_episodes: int = _argument(100, "Episodes a goal in the evaluation at the end.")


_LIMITS: dict[str, float] = {
    "steps": 1,
    "imitate_steps": 1,
    "seed": 0,
    "envs": 1,
    "rollout": 1,
    "batch_size": 1,
    "epochs": 1,
    "gradient_steps": 1,
    "buffer_size": 1,
    "learning_starts": 0,
    "exploration_steps": 1,
    "exploration_final": 0.0,
    "action_noise": 0.0,
    "evaluations": 1,
    "eval_episodes": 1,
    "final_episodes": 1,
    "checkpoints": 1,
}

_ONLY: dict[str, tuple[str, ...]] = {
    "imitate": ON_POLICY,
    "imitate_steps": ON_POLICY,
    "gae_lambda": ON_POLICY,
    "ent_coef": (*ON_POLICY, "sac"),
    "ent_coef_start": ("sac",),
    "batch_size": ("ppo", "maskable-ppo", "dqn", "sac", "td3"),
    "epochs": ("ppo", "maskable-ppo"),
    "clip_range": ("ppo", "maskable-ppo"),
    "gradient_steps": ("dqn", "sac", "td3"),
    "buffer_size": ("dqn", "sac", "td3"),
    "learning_starts": ("dqn", "sac", "td3"),
    "exploration_steps": ("dqn",),
    "exploration_final": ("dqn",),
    "action_noise": ("td3",),
}
"""Fields that are some algorithms' own."""

_DEFAULTS: dict[str, Any] = {
    "gamma": 0.99,
    "buffer_size": 1_000_000,
    "learning_starts": 100,
    "exploration_steps": 30_000,
    "exploration_final": 0.01,
    "action_noise": 0.1,
    "epochs": 10,
    "clip_range": 0.2,
}


Arguments = TypeVar("Arguments")


def _converted(name: str, hint: Any, value: Any, where: str) -> Any:
    """The value as the field's type, or a ValueError that says what is wanted."""
    kinds = [kind for kind in (get_args(hint) or (hint,)) if kind is not type(None)]
    if get_origin(hint) is tuple:
        kinds = [hint]
    kind = kinds[0]
    if value is None and type(None) in get_args(hint):
        return None
    if get_origin(kind) is tuple:
        inner = get_args(kind)[0]
        items = [value] if isinstance(value, (str, int)) else value
        if isinstance(items, (list, tuple)) and items and all(type(item) is inner for item in items):
            return tuple(items)
        raise ValueError(f"{where}: {name}: needs a list of {inner.__name__}, given {value!r}")
    if kind is float and type(value) is int:
        value = float(value)
    if kind is int and type(value) is float and value.is_integer():
        value = int(value)  # 1e6 is how people write a million
    if type(value) is not kind:
        raise ValueError(f"{where}: {name}: needs {kind.__name__}, given {value!r}")
    return value


def _given(kind: type[Any], values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """What was given of a dataclass's fields, as the fields' types."""
    hints = get_type_hints(kind)
    names = [f.name for f in fields(kind)]
    given = {}
    for name, value in values.items():
        if name not in names:
            near = difflib.get_close_matches(name, names, 1)
            raise ValueError(f"{where}: {name}: no such argument{f'; did you mean {near[0]}?' if near else ''}")
        if value is not None:
            given[name] = _converted(name, hints[name], value, where)
    return given


def arguments_of(values: Mapping[str, Any], where: str = "arguments") -> TrainArguments:
    """Arguments from {field: value}; what is not there is the preset's.

    Args:
        values: as a TOML table has them; None where a flag was not given.
        where: file or command, for errors.

    Raises:
        ValueError: unknown field, or a value of the wrong type or out of bounds.
    """
    given = _given(TrainArguments, values, where)
    given["env_id"] = _SHORT.get(given.get("env_id", ""), given.get("env_id", TrainArguments.env_id))
    preset = given.get("preset", "paper")
    if preset not in PRESETS:
        raise ValueError(f"{where}: preset: known: {', '.join(PRESETS)}; given {preset!r}")
    arguments = TrainArguments(**{**PRESETS[preset], **given})
    _check(arguments, where)
    return arguments


def _check(arguments: TrainArguments, where: str) -> None:
    algo = arguments.algo
    if algo not in ALGORITHMS:
        raise ValueError(f"{where}: algo: known: {', '.join(ALGORITHMS)}; given {algo!r}")
    for name, least in _LIMITS.items():
        value = getattr(arguments, name)
        if value is not None and value < least:
            raise ValueError(f"{where}: {name}: must be at least {least}, given {value}")
    for name, algorithms in _ONLY.items():
        if getattr(arguments, name) is not None and algo not in algorithms:
            raise ValueError(f"{where}: {name}: is for {', '.join(algorithms)}, not for {algo}")
    curriculum_of(arguments, ())
    for name in ("learning_rate", "ent_coef_start"):
        value = getattr(arguments, name)
        if value is not None and value <= 0.0:
            raise ValueError(f"{where}: {name}: must be above 0, given {value}")
    if arguments.ent_coef is not None and arguments.ent_coef_start is not None:
        raise ValueError(f"{where}: ent_coef_start: is where a learned weight begins; ent_coef fixes it")


class Stage(NamedTuple):
    """A stage of a curriculum."""

    until: int
    """The step at which it is over."""
    shares: dict[str, float]
    """Of the episodes, by what the vessel they begin with is on its way to."""


BACKWARD = "backward"
_WHOLE = 0.6
"""Share of a run after which every episode is a whole one, by ``backward``."""


def curriculum_of(arguments: TrainArguments, benches: Sequence[str]) -> list[Stage]:
    """The stages of a run, in order; after the last all episodes begin with the scenario's own shelf.

    ``backward`` has a stage for each bench, from the last to the first: whatever is known already and what is new begin
    equally often.

    Args:
        arguments: the run.
        benches: of the scenario, in the order of a workflow.

    Raises:
        ValueError: a stage that is not understood, or stages out of order.
    """
    stages = []
    for text in arguments.curriculum or ():
        if text == BACKWARD:
            for new in range(1, len(benches) + 1):
                begun = ["submit", *reversed(benches)][: new + 1]
                end = int(arguments.steps * _WHOLE * new / len(benches))
                stages.append(Stage(end, dict.fromkeys(begun, 1.0 / (new + 1))))
            continue
        until, colon, shares = text.partition(":")
        pairs = [pair.partition("=") for pair in shares.split()]
        try:
            stage = Stage(int(until.replace("_", "")), {name: float(share) for name, _, share in pairs})
        except ValueError:
            stage = Stage(0, {})
        if not colon or not stage.shares or stage.until <= (stages[-1].until if stages else 0):
            raise ValueError(
                f"curriculum: stages are 'STEP: BENCH=SHARE ...' with growing steps, or {BACKWARD}; given {text!r}"
            )
        stages.append(stage)
    return stages


def load_arguments(path: Path | None, flags: Mapping[str, Any]) -> TrainArguments:
    """Arguments from a TOML file and flags, which win.

    Raises:
        DataError: the file is missing or not TOML.
        ValueError: unknown field, or a value of the wrong type or out of bounds.
    """
    values = {} if path is None else read_toml(path)
    if path is not None:
        arguments_of(values, str(path))
    return arguments_of({**values, **{k: v for k, v in flags.items() if v is not None}}, "train")


def merged(kind: type[Arguments], path: Path | None, flags: Mapping[str, Any], command: str) -> Arguments:
    """A dataclass of arguments from a TOML file and a command's flags, which win.

    Raises:
        DataError: the file is missing or not TOML.
        ValueError: unknown field, or a value of the wrong type.
    """
    values = {} if path is None else _given(kind, read_toml(path), str(path))
    return kind(**{**values, **_given(kind, flags, command)})


def load_joint_arguments(path: Path | None, flags: Mapping[str, Any]) -> JointArguments:
    """Arguments of joint training from a TOML file and flags, which win.

    Raises:
        DataError: the file is missing or not TOML.
        ValueError: unknown field, or a value of the wrong type or out of bounds.
    """
    arguments = merged(JointArguments, path, flags, "train-together")
    for name in ("steps", "envs", "rollout", "period", "batch_size", "epochs", "evaluations", "eval_episodes"):
        if getattr(arguments, name) < 1:
            raise ValueError(f"train-together: {name}: must be at least 1, given {getattr(arguments, name)}")
    if arguments.regime not in ("together", "in-turns"):
        raise ValueError(f"train-together: regime: together or in-turns, given {arguments.regime!r}")
    return arguments


def resolved(arguments: TrainArguments) -> TrainArguments:
    """The same with every default of ours that depends on the algorithm filled in (SB3's own stay None)."""
    known = {**_DEFAULTS, "gradient_steps": 256 if arguments.algo == "dqn" else 128}
    values = {
        name: value
        for name, value in known.items()
        if getattr(arguments, name) is None and arguments.algo in _ONLY.get(name, ALGORITHMS)
    }
    return replace(arguments, **values)


def label_of(arguments: TrainArguments) -> str:
    """What figures and tables call it: the preset's name if it is not the paper's, else the algorithm's; both where
    the algorithm is not the preset's."""
    if arguments.preset == "paper":
        return arguments.algo
    own = PRESETS[arguments.preset].get("algo", arguments.algo)
    return arguments.preset if arguments.algo == own else f"{arguments.preset}-{arguments.algo}"


def folder_of(arguments: TrainArguments, label: str | None = None) -> Path:
    """Where a run stands in a folder of results: bench, label, seed."""
    bench = arguments.env_id.rpartition("/")[2].rpartition("-v")[0] or arguments.env_id
    other = {"Bench": "rxn", "LabAgent": "manager_0", "LabManager": "manager_0"}.get(bench)
    if other is not None:
        bench = f"{Path(arguments.scenario or 'wurtz_dodecane').stem}-{arguments.bench or other}"
    return Path(bench, label or label_of(arguments), f"seed-{arguments.seed}")


def flags_of(arguments: TrainArguments) -> list[str]:
    """What to give ``chemlab train`` after the environment to get these arguments."""
    preset = TrainArguments(**PRESETS[arguments.preset])
    flags = []
    for f in fields(TrainArguments):
        value = getattr(arguments, f.name)
        # Some are always said: a command should show what it trains.
        if f.name == "env_id" or (value == getattr(preset, f.name) and f.name not in ("algo", "steps", "seed")):
            continue
        for item in value if isinstance(value, tuple) else (value,):
            flags += [f"--{f.name.replace('_', '-')}", str(item)]
    return flags
