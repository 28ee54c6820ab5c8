"""What a training run is told: dataclasses, checked when they are made, from presets, TOML files and flags.

Later ones win: the field's default, the preset, the config file, flags. Fields of ``chemlab train`` that are None
follow the algorithm: Stable-Baselines3's defaults, and the paper's protocol where the paper says something
(:func:`resolved`).

The paper's protocol: 10 environments; gather 256 steps in each, then update. PPO and A2C learn from those 2560 steps
alone (so A2C makes one gradient step from them). DQN, SAC and TD3 keep 1M steps and sample them: 256 gradient steps of
DQN after each 2560 steps, 128 of SAC and TD3, whose gradient steps are ten times as expensive. The paper does not say
how many there were. DQN's exploration falls from 1.0 to 0.01 within the first 30k steps.
"""

from __future__ import annotations

import difflib
import functools
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import Field, asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

from chemlab.config.datafile import read_toml

__all__ = [
    "ALGORITHMS",
    "PRESETS",
    "RECURRENT",
    "Arguments",
    "JointArguments",
    "RllibArguments",
    "Stage",
    "TeamArguments",
    "TrainArguments",
    "curriculum_of",
    "help_of",
    "label_of",
    "resolved",
]

RECURRENT: tuple[str, ...] = ("recurrent-ppo", "maskable-recurrent-ppo")
"""Algorithms that remember an episode."""
_PPO = ("ppo", "maskable-ppo", *RECURRENT)
_ON_POLICY = (*_PPO, "a2c")
_VALUES = ("dqn", "qr-dqn")
_REPLAY = (*_VALUES, "sac", "td3")
ALGORITHMS: tuple[str, ...] = ("ppo", "a2c", *_REPLAY, "maskable-ppo", *RECURRENT)
"""What ``algo`` may be."""

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
    "manager": {**_MANAGER, "learning_rate": 3e-4, "imitate": "scripted"},
    "manager-curriculum": {**_MANAGER, "learning_rate": 1e-3, "curriculum": ("backward",)},
    "ppo-xl": {"algo": "ppo", "envs": 32, "steps": 2_000_000},
    "sac-cool": {"algo": "sac", "ent_coef_start": 0.01},
}
"""Presets: the fields that differ from the defaults, which are the paper's protocol."""

_SHORT = {"manager": "chemlab/LabManager-v0"}
"""What people may call an environment for short."""

_SB3_BATCH = {"maskable-ppo": 64, **dict.fromkeys(RECURRENT, 128)}
"""Minibatch in SB3 of those that normalize the advantages of a single step."""

_MOST_SEED = 2**32 - 1
"""NumPy's global generator, which SB3 seeds, takes no larger one."""


def _argument(default: Any, text: str, **bounds: Any) -> Any:
    """A field: its default, what it is, and its bounds.

    ``least``, ``most``, ``above`` bound a number (or each of several), ``known`` lists the choices; ``otherwise`` is
    what None stands for (:func:`resolved` fills in numbers), ``place`` marks what says where a run is computed and not
    what it learns.
    """
    return field(default=default, metadata={"help": text, **bounds}, kw_only=True)


def _positional(default: str, text: str) -> Any:
    """The one field that is given without its name, by a command too."""
    return field(default=default, metadata={"help": text})


def _other_default(name: str, default: Any, kind: type[Any] | None = None) -> Any:
    """A field of another kind of run (:class:`Arguments`) that begins with another value."""
    of: Field[Any] = (kind or Arguments).__dataclass_fields__[name]
    return field(default=default, metadata=of.metadata, kw_only=True)


A = TypeVar("A", bound="Arguments")


@dataclass(frozen=True)
class Arguments:
    """What every training run is told, whoever computes the updates.

    Raises:
        ValueError: a value is out of bounds; which one, its bounds, and what was given.
    """

    command: ClassVar[str] = ""
    """The command of ``chemlab`` that takes them."""

    steps: int = _argument(
        1_000_000, "Steps in all environments together; rounded up to whole rollouts.", least=1, most=10**12
    )
    split: str = _argument(
        "train", "Worlds to train in, of a scenario that draws some; evaluations of train are in validation."
    )
    seed: int = _argument(0, "Seed of networks, exploration and environments.", least=0, most=_MOST_SEED)
    envs: int = _argument(10, "Environments side by side.", least=1, most=100_000)
    learning_rate: float | None = _argument(None, "Learning rate.", above=0.0)
    gamma: float | None = _argument(None, "Discount.", least=0.0, most=1.0, otherwise=0.99)
    gae_lambda: float | None = _argument(None, "GAE lambda of PPO and A2C.", least=0.0, most=1.0)
    ent_coef: float | None = _argument(
        None, "Weight of the entropy.", least=0.0, otherwise="0 on policy, learned by SAC"
    )
    clip_range: float | None = _argument(None, "PPO's clip range.", above=0.0, otherwise=0.2)
    batch_size: int | None = _argument(None, "Minibatch of PPO and of replay.", least=2, most=10**7)
    epochs: int | None = _argument(None, "PPO's passes over a rollout.", least=1, most=10_000, otherwise=10)
    evaluations: int = _argument(
        10, "Evaluations during training, evenly spread, beside the scripted policy.", least=1, most=100_000
    )
    eval_episodes: int = _argument(20, "Episodes a goal in each of them.", least=1, most=100_000)
    final_episodes: int = _argument(100, "Episodes a goal in the evaluation at the end.", least=1, most=100_000)
    checkpoints: int = _argument(
        40, "Checkpoints during training, evenly spread (a crash loses what is after the last).", least=1, most=100_000
    )

    def __post_init__(self) -> None:
        from chemlab.config.draws import Split

        Split.of(self.split)
        for f in fields(self):
            value = getattr(self, f.name)
            for item in value if isinstance(value, tuple) else (value,):
                _check(f, item)

    @classmethod
    def of(cls: type[A], values: Mapping[str, Any], where: str = "arguments") -> A:
        """Arguments from {field: value}; what is not there is the default.

        Args:
            values: as a TOML table has them; None where a flag was not given.
            where: file or command, for errors.

        Raises:
            ValueError: unknown field, or a value of the wrong type or out of bounds.
        """
        given = cls._completed(_given(cls, values, where), where)
        try:
            made = cls(**given)
            _check_imitated(made)
            return made
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from error

    @classmethod
    def as_recorded(cls: type[A], values: Mapping[str, Any], where: str) -> A:
        """Arguments as a run's ``config.json`` has them, where presets are filled in; errors as :meth:`of`."""
        try:
            return cls(**_given(cls, values, where))
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from error

    @classmethod
    def load(cls: type[A], path: Path | None, flags: Mapping[str, Any]) -> A:
        """Arguments from a TOML file and a command's flags, which win.

        Raises:
            DataError: the file is missing or not TOML.
            ValueError: unknown field, or a value of the wrong type or out of bounds.
        """
        if path is None:
            return cls.of(flags, cls.command)
        values = _given(cls, read_toml(path), str(path))
        return cls.of({**values, **flags}, f"{cls.command} --config {path}")

    @classmethod
    def ordered(cls) -> list[Field[Any]]:
        """The fields as people read them: what is this kind of run's own, then what every run is told."""
        common = Arguments.__dataclass_fields__
        return sorted(fields(cls), key=lambda f: f.name in common)

    @classmethod
    def _completed(cls, given: dict[str, Any], where: str) -> dict[str, Any]:
        """What is given, with what it implies."""
        return given

    def folder(self) -> Path:
        """Where a run stands in a folder of results."""
        raise NotImplementedError

    def recorded(self) -> dict[str, Any]:
        """What a run's ``config.json`` says of them: a run may go on in another place."""
        unsaid = [f.name for f in fields(self) if f.metadata.get("place")]
        # What there was no other of when the first runs were described.
        unsaid += ["split"] if self.split == "train" else []
        unsaid += [name for name in ("actions", "memory", "advice") if getattr(self, name, None) is None]
        unsaid += ["critic"] if getattr(self, "critic", "own") == "own" else []
        return {name: value for name, value in asdict(self).items() if name not in unsaid}

    @property
    def evaluation_split(self) -> str:
        """Worlds that evaluations are in."""
        return "validation" if self.split == "train" else self.split

    def flags(self, always: Sequence[str] = (), implied: Arguments | None = None) -> list[str]:
        """What to give the command after the positional argument to get them.

        Args:
            always: fields to say even where they are as they would be.
            implied: what the others are without being said (default: the defaults).
        """
        implied = type(self)() if implied is None else implied
        words = []
        for f in self.ordered():
            name, value = f.name, getattr(self, f.name)
            if not f.kw_only or f.metadata.get("place") or (value == getattr(implied, name) and name not in always):
                continue
            for item in value if isinstance(value, tuple) else (value,):
                words += [f"--{name.replace('_', '-')}", str(item)]
        return words

    def command_line(self) -> str:
        """The command that trains it again."""
        (positional,) = (getattr(self, f.name) for f in fields(self) if not f.kw_only)
        return shlex.join(["chemlab", self.command, positional, *self.flags()])


def _check_imitated(arguments: Arguments) -> None:
    """Whether there is somebody to imitate where it is said how; runs of before may not have been asked."""
    somebody = any(getattr(arguments, name, None) is not None for name in ("imitate", "advice"))
    for name in ("imitate_steps", "imitate_rounds", "imitate_spread"):
        if not somebody and getattr(arguments, name, None) is not None:
            raise ValueError(f"{name}: nobody is imitated; give imitate, or leave it out")


@dataclass(frozen=True)
class TrainArguments(Arguments):
    """Everything that decides what a run of ``chemlab train`` learns."""

    command = "train"

    env_id: str = _positional(
        "chemlab/WurtzReaction-v0", "Environment to train in, as registered with Gymnasium; manager for short."
    )
    algo: str = _argument("ppo", f"Algorithm: {', '.join(ALGORITHMS)}.", known=ALGORITHMS)
    preset: str = _argument("paper", f"Defaults to start from: {', '.join(PRESETS)}.", known=tuple(PRESETS))
    scenario: str | None = _argument(
        None,
        "Scenario, for chemlab/Bench-v0 and the laboratory's views (others have their own).",
        otherwise="wurtz_dodecane",
    )
    bench: str | None = _argument(
        None,
        "Bench of the scenario, for chemlab/Bench-v0; the agent, for chemlab/LabAgent-v0 (others have their own).",
        otherwise="rxn; manager_0",
    )
    background: str | None = _argument(
        None,
        "Who plays the other roles of a laboratory, by name.",
        otherwise="scripted, for the laboratory's views",
    )
    goals: tuple[str, ...] | None = _argument(None, "Goals to train for; repeat the option.", otherwise="all")
    actions: str | None = _argument(
        None,
        "Actions of benches: native, or discrete (a choice among some, where they are continuous).",
        known=("native", "discrete"),
        otherwise="the scenario's",
    )
    starts: str = _argument(
        "paper", "Starting states: paper, lab (as vessels reach the bench in a laboratory), or both."
    )
    curriculum: tuple[str, ...] | None = _argument(
        None,
        "Curriculum of a laboratory's role: backward (from the last bench to the first), or stages 'STEP: BENCH=SHARE "
        "...': until that step such shares of the episodes begin with a vessel on its way to the bench, or to submit, "
        "the rest with the scenario's shelf; repeat the option.",
        otherwise="none",
    )
    imitate: str | None = _argument(
        None, "Policy to imitate before learning, by name (scripted, scripted:unsafe, ...).", otherwise="none"
    )
    imitate_steps: int | None = _argument(None, "About how many of its turns.", least=1, most=10**9, otherwise="20000")
    imitate_rounds: int | None = _argument(
        None,
        "In how many parts; after the first the learner plays, and is shown what the policy would have played.",
        least=1,
        most=1000,
        otherwise="1",
    )
    imitate_spread: float | None = _argument(
        None,
        "Standard deviation that a clone's continuous actions begin with at least: how widely it explores.",
        above=0.0,
        most=1.0,
        otherwise="0.02",
    )
    advice: str | None = _argument(
        None,
        "Policy whose choice a laboratory's manager is shown with each observation, by name; it begins by following "
        "that, and learns where something else is better.",
        otherwise="none",
    )
    rollout: int = _argument(256, "Steps gathered in each environment before each update.", least=1, most=10**7)
    ent_coef_start: float | None = _argument(
        None, "What SAC's learned weight of the entropy begins with.", above=0.0, otherwise="1.0, SB3's"
    )
    gradient_steps: int | None = _argument(
        None, "Gradient steps from replay after each rollout.", least=1, most=10**7, otherwise="256; SAC, TD3 128"
    )
    buffer_size: int | None = _argument(None, "Steps kept for replay.", least=1, most=10**9, otherwise=1_000_000)
    learning_starts: int | None = _argument(
        None, "Random steps before learning from replay.", least=0, most=10**12, otherwise=100
    )
    exploration_steps: int | None = _argument(
        None, "Steps in which DQN's exploration falls to its end.", least=1, most=10**12, otherwise=30_000
    )
    exploration_final: float | None = _argument(
        None, "DQN's exploration after that.", least=0.0, most=1.0, otherwise=0.01
    )
    action_noise: float | None = _argument(
        None, "Standard deviation of TD3's exploration, of [-1, 1].", least=0.0, otherwise=0.1
    )
    net_arch: tuple[int, ...] | None = _argument(None, "Hidden layers; repeat the option.", least=1, most=16_384)
    memory: int | None = _argument(None, "Size of the LSTM of a recurrent learner.", least=1, most=65_536)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, algorithms in _ONLY.items():
            if getattr(self, name) is not None and self.algo not in algorithms:
                raise ValueError(f"{name}: is for {', '.join(algorithms)}, not for {self.algo}")
        if self.ent_coef is not None and self.ent_coef_start is not None:
            raise ValueError("ent_coef_start: is where a learned weight begins; ent_coef fixes it")
        if self.algo in _PPO and self.envs * self.rollout < 2:
            raise ValueError("rollout: PPO needs at least 2 steps (envs x rollout) before each update, given 1")
        minibatch = self.batch_size or _SB3_BATCH.get(self.algo, 0)
        if minibatch and self.algo in _SB3_BATCH and self.envs * self.rollout % minibatch == 1:
            raise ValueError(
                f"batch_size: of the {self.envs * self.rollout} steps of a rollout a single one would be left for the "
                "last minibatch, where advantages are normalized; give another, or another rollout"
            )
        if self.advice is not None and self.imitate not in (None, self.advice):
            raise ValueError(f"imitate: who is advised begins by following the advice, {self.advice!r}; leave it out")
        curriculum_of(self, ())

    @classmethod
    def ordered(cls) -> list[Field[Any]]:
        """The fields as people read them: what is this kind of run's own, then what every run is told."""
        common = Arguments.__dataclass_fields__
        return sorted(fields(cls), key=lambda f: f.name in common)

    @classmethod
    def _completed(cls, given: dict[str, Any], where: str) -> dict[str, Any]:
        preset = given.get("preset", "paper")
        if preset not in PRESETS:
            raise ValueError(f"{where}: preset: known: {', '.join(PRESETS)}; given {preset!r}")
        given = {**PRESETS[preset], **given}
        env_id = given.get("env_id", cls.env_id)
        return {**given, "env_id": _SHORT.get(env_id, env_id)}

    def folder(self, label: str | None = None) -> Path:
        """Where a run stands in a folder of results: bench, label (default: :func:`label_of`), seed."""
        task = self.env_id.rpartition("/")[2].rpartition("-v")[0] or self.env_id
        other = {"Bench": "rxn", "LabAgent": "manager_0", "LabManager": "manager_0"}.get(task)
        if other is not None:
            task = f"{Path(self.scenario or 'wurtz_dodecane').stem}-{self.bench or other}"
        return Path(task, label or label_of(self), f"seed-{self.seed}")

    def flags(self, always: Sequence[str] = ("algo", "steps", "seed"), implied: Arguments | None = None) -> list[str]:
        """See :meth:`Arguments.flags`; what the preset implies is not said."""
        return super().flags(always, TrainArguments(**PRESETS[self.preset]) if implied is None else implied)


@dataclass(frozen=True)
class TeamArguments(Arguments):
    """What a run is told in which several roles of a laboratory learn, each with a learner of its own."""

    scenario: str = _positional("wurtz_dodecane", "Scenario: a shipped name or a path.")
    roles: tuple[str, ...] | None = _argument(
        None, "Roles that learn: manager and bench keys; repeat the option.", otherwise="all"
    )
    background: str = _argument("scripted", "Who plays the roles that do not learn, by name.")
    rewards: str | None = _argument(None, "Another reward mix than the scenario's.", otherwise="the scenario's")
    manager_gamma: float = _argument(1.0, "Discount a decision of the manager.", least=0.0, most=1.0)
    steps: int = _argument(1_000_000, "Turns of learning agents, all laboratories together.", least=1, most=10**12)
    learning_rate: float = _other_default("learning_rate", 3e-4)
    gamma: float = _argument(0.99, "Discount a turn of a bench's agent.", least=0.0, most=1.0)
    gae_lambda: float = _other_default("gae_lambda", 0.95)
    ent_coef: float = _argument(0.01, "Weight of the entropy of discrete actions.", least=0.0)
    clip_range: float = _other_default("clip_range", 0.2)
    batch_size: int = _argument(256, "Minibatch of each role.", least=2, most=10**7)
    epochs: int = _other_default("epochs", 10)


@dataclass(frozen=True)
class JointArguments(TeamArguments):
    """Everything that decides what a run of ``chemlab train-together`` learns."""

    command = "train-together"

    regime: str = _argument("together", "together, or in-turns (round-robin).", known=("together", "in-turns"))
    critic: str = _argument(
        "own",
        "What critics see: own (their agent's observation), or state (the laboratory's, too).",
        known=("own", "state"),
    )
    period: int = _argument(10, "Updates before the next role's turn (in-turns).", least=1, most=10**9)
    begin_from: str | None = _argument(
        None,
        "Where to start from: a joint run, a folder of runs by role, or ROLE=RUN,ROLE=RUN.",
        otherwise="scratch",
    )
    imitate: str | None = _argument(
        None, "Policy to imitate before learning, in every role that learns, by name.", otherwise="none"
    )
    imitate_steps: int | None = _argument(
        None, "Turns of it in each role, about.", least=1, most=10**9, otherwise="20000"
    )
    imitate_rounds: int | None = _other_default("imitate_rounds", None, TrainArguments)
    imitate_spread: float | None = _other_default("imitate_spread", None, TrainArguments)
    envs: int = _argument(64, "Laboratories side by side.", least=1, most=100_000)
    rollout: int = _argument(64, "Rounds (a manager action, or a tick) before each update.", least=1, most=10**7)
    by_ticks: bool = _argument(False, "Discount by elapsed ticks instead of turns.")
    net_arch: tuple[int, ...] | None = _argument(
        None, "Hidden layers of every role; repeat the option.", least=1, most=16_384
    )

    def folder(self) -> Path:
        """Where a run stands in a folder of results: scenario, regime (and critic), seed."""
        regime = self.regime if self.critic == "own" else f"{self.regime}-{self.critic}"
        return Path(f"{Path(self.scenario).stem}-joint", regime, f"seed-{self.seed}")


@dataclass(frozen=True)
class RllibArguments(TeamArguments):
    """Everything that decides what a run of ``chemlab train-rllib`` learns, and where."""

    command = "train-rllib"

    address: str | None = _argument(
        None,
        "Ray cluster: HOST:PORT, or auto for the one that runs on this machine.",
        otherwise="a Ray of its own",
        place=True,
    )
    runners: int = _argument(
        1, "Env runners: processes that play, anywhere in the cluster, a CPU each.", least=1, most=10_000, place=True
    )
    envs: int = _argument(8, "Laboratories in each env runner.", least=1, most=100_000)
    batch: int = _argument(
        4096, "Turns gathered before each update, all runners and roles together.", least=1, most=10**8
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.batch < self.runners * self.envs:
            raise ValueError(
                f"batch: must be at least a turn in each of the {self.runners * self.envs} laboratories "
                f"(runners x envs), given {self.batch}"
            )
        if self.batch_size > self.batch:
            raise ValueError(f"batch_size: must be at most batch, {self.batch}, given {self.batch_size}")

    def folder(self) -> Path:
        """Where a run stands in a folder of results: scenario, who learns, seed."""
        return Path(f"{Path(self.scenario).stem}-rllib", "-".join(self.roles or ("all",)), f"seed-{self.seed}")


_ONLY: dict[str, tuple[str, ...]] = {
    "imitate": _ON_POLICY,
    "imitate_steps": _ON_POLICY,
    "imitate_rounds": _ON_POLICY,
    "imitate_spread": ("ppo", "a2c", "recurrent-ppo"),
    "advice": ("maskable-ppo", "maskable-recurrent-ppo"),
    "gae_lambda": _ON_POLICY,
    "ent_coef": (*_ON_POLICY, "sac"),
    "ent_coef_start": ("sac",),
    "batch_size": (*_PPO, *_REPLAY),
    "epochs": _PPO,
    "clip_range": _PPO,
    "gradient_steps": _REPLAY,
    "buffer_size": _REPLAY,
    "learning_starts": _REPLAY,
    "exploration_steps": _VALUES,
    "exploration_final": _VALUES,
    "action_noise": ("td3",),
    "memory": RECURRENT,
}
"""Fields that are some algorithms' own."""


def help_of(argument: Field[Any]) -> str:
    """What a field is and what it is by default, for people."""
    default = argument.default
    if default is None:
        default = argument.metadata.get("otherwise", "the algorithm's in SB3")
    return f"{argument.metadata['help']} Default: {default}."


def _check(argument: Field[Any], value: Any) -> None:
    """Refuse a value that is out of a field's bounds."""
    bounds, name = argument.metadata, argument.name
    if value is not None and "known" in bounds and value not in bounds["known"]:
        raise ValueError(f"{name}: known: {', '.join(bounds['known'])}; given {value!r}")
    if not isinstance(value, (int, float)):
        return
    if not math.isfinite(value):
        raise ValueError(f"{name}: must be a finite number, given {value}")
    least, most, above = (bounds.get(key) for key in ("least", "most", "above"))
    if above is not None and value <= above:
        raise ValueError(f"{name}: must be above {above:g}, given {value}")
    if (least is not None and value < least) or (most is not None and value > most):
        wanted = f"at least {least:g}" if least is not None and value < least else f"at most {most}"
        raise ValueError(f"{name}: must be {wanted}, given {value}")


def _converted(name: str, hint: Any, value: Any, where: str) -> Any:
    """The value as the field's type, or a ValueError that says what is wanted."""
    kinds = [kind for kind in (get_args(hint) or (hint,)) if kind is not type(None)]
    if get_origin(hint) is tuple:
        kinds = [hint]
    kind = kinds[0]
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


@functools.cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def _given(kind: type[Arguments], values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """What was given of a dataclass's fields, as the fields' types."""
    own: Any = kind  # mypy takes a class for as little hashable as it thinks its objects are
    hints = _hints(own)
    names = [f.name for f in fields(kind)]
    given = {}
    for name, value in values.items():
        if name not in names:
            near = difflib.get_close_matches(name, names, 1)
            raise ValueError(f"{where}: {name}: no such argument{f'; did you mean {near[0]}?' if near else ''}")
        if value is not None:
            given[name] = _converted(name, hints[name], value, where)
    return given


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


def resolved(arguments: TrainArguments) -> TrainArguments:
    """The same with every default of ours that depends on the algorithm filled in (SB3's own stay None)."""
    ours: dict[str, Any] = {
        f.name: f.metadata["otherwise"]
        for f in fields(TrainArguments)
        if type(f.metadata.get("otherwise")) in (int, float)
    }
    ours["gradient_steps"] = 256 if arguments.algo in _VALUES else 128
    values = {
        name: value
        for name, value in ours.items()
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
