"""Arguments of training: one model per algorithm, used by the command line, TOML files and Python.

>>> from chemlab.agents.train.arguments import PPO, training_arguments
>>> PPO(scenario="wurtz_dodecane", bench="rxn", steps=300_000).learning_rate
0.0003
>>> training_arguments({"scenario": "wurtz_dodecane", "roles": "all"}).algo
'ippo'

The order of precedence, lowest first, is default, preset, TOML file, flag. Defaults are those of the paper's protocol;
values that the paper does not state are Stable-Baselines3's.

In the paper's protocol, 10 environments take 256 steps each between updates. PPO and A2C learn from these 2560 steps.
DQN, SAC and TD3 keep 1M steps in the replay buffer. The paper does not state their gradient steps; here, DQN makes 256
after each 2560 steps, SAC and TD3 make 128, each ten times as expensive. DQN's epsilon falls from 1.0 to 0.01 within
the first 30k steps.
"""

from __future__ import annotations

import difflib
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from chemlab.config.datafile import DataError, read_toml, shown
from chemlab.config.datamodel import validated

from ..former_names import current_name

if TYPE_CHECKING:
    from typing_extensions import Self


def _whole(value: Any) -> Any:
    """Return a float without fraction, such as 1e6, as an integer; anything else unchanged."""
    return int(value) if type(value) is float and value.is_integer() else value


def _several(value: Any) -> Any:
    """Return a value or a list as a tuple; texts are split at commas."""
    values = value if isinstance(value, (list, tuple)) else [value]
    return tuple(part for one in values for part in (one.split(",") if isinstance(one, str) else [one]))


Count = Annotated[int, BeforeValidator(_whole), Field(ge=1, le=100_000)]
Many = Annotated[int, BeforeValidator(_whole), Field(ge=1, le=10**12)]
Words = Annotated[tuple[str, ...], BeforeValidator(_several), Field(min_length=1)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0, le=1e6)]
Weight = Annotated[float, Field(ge=0.0, le=1e6)]
Turns = Annotated[int, BeforeValidator(_whole), Field(ge=1, le=10**7)]
Layers = Annotated[tuple[Annotated[int, Field(ge=1, le=16_384)], ...], BeforeValidator(_several), Field(min_length=1)]
Minibatch = Annotated[int, BeforeValidator(_whole), Field(ge=2, le=10**7)]
Epochs = Annotated[int, Field(ge=1, le=10_000)]
Play = Literal["greedy", "sampled", "better"]
Spread = Annotated[float, Field(gt=0.0, le=1.0)]


ABOUT: dict[str, str] = {
    "scenario": "Scenario (name or path), or the id of an environment of one agent (chemlab/WurtzReaction-v0).",
    "roles": "Learners in the laboratory: all, roles (manager, rxn) or agents (rxn_0).",
    "algo": "Algorithm.",
    "preset": "Set of defaults.",
    "background": "Policy of the other roles of the laboratory. Default: scripted.",
    "split": "Split of worlds to train in, of a scenario with hidden parameters.",
    "steps": "Steps in all environments together (ippo, mappo: turns of the learners); rounded up to whole rollouts.",
    "seed": "Seed of networks, exploration and environments.",
    "envs": "Number of environments in the batch.",
    "rollout": "Steps in each environment before each update (ippo, mappo: half a manager's action limit, 32 to 128).",
    "learning_rate": "Learning rate.",
    "gamma": "Discount (ippo, mappo: of benches).",
    "net_arch": "Sizes of the hidden layers; repeat the option for each.",
    "evaluations": "Evaluations during training, evenly spread.",
    "eval_episodes": "Episodes per goal of each evaluation.",
    "final_episodes": "Episodes per goal of the final evaluation.",
    "checkpoints": "Checkpoints during training, evenly spread.",
    "bc": "Name of a policy to clone before learning (behaviour cloning).",
    "bc_steps": "Approximate number of turns of that policy to clone, for each role.",
    "bc_rounds": "DAgger rounds; after the first, the learner acts and the cloned policy labels its turns.",
    "bc_std": "Lower bound of the initial standard deviation of a clone's continuous actions.",
    "bench": "Bench of the scenario to train on its own, outside the laboratory.",
    "goals": "Goals to train for; repeat the option for each. Default: all.",
    "actions": "Actions of benches: native, or discrete (representative ones). Default: the scenario's.",
    "starts": "Initial-state distribution of a bench on its own: paper, lab or both.",
    "curriculum": "Reverse curriculum in a laboratory: backward (from the last bench to the first), or stages 'STEP: "
    "BENCH=SHARE ...'; repeatable. Until that step, these shares of the episodes begin with a vessel ready for the "
    "bench (or to submit), the others with the scenario's shelf.",
    "play": "Actions of the learned policy, in evaluations and later: greedy, sampled, or better (the better of both).",
    "gae_lambda": "GAE lambda.",
    "ent_coef": "Weight of the entropy bonus (sac: learned unless given).",
    "clip_range": "Clip range.",
    "epochs": "Passes over each rollout.",
    "batch_size": "Size of a minibatch.",
    "hints": "Name of a policy whose action the manager observes (teacher hints); it is also cloned.",
    "memory": "Size of the LSTM.",
    "gradient_steps": "Gradient steps after each rollout.",
    "buffer_size": "Steps kept in the replay buffer.",
    "learning_starts": "Random steps before learning.",
    "exploration_steps": "Steps over which epsilon falls from 1 to its final value.",
    "exploration_final": "Final value of epsilon.",
    "ent_coef_start": "Initial value of a learned weight of the entropy bonus.",
    "action_noise": "Standard deviation of exploration noise, for actions in [-1, 1].",
    "rewards": "Reward mix. Default: the scenario's.",
    "regime": "Roles learn together, or in-turns (round-robin).",
    "period": "Updates of a role before the next role learns (in-turns only).",
    "begin_from": "Initial policies: a policy of several roles, a folder of policies by role, or ROLE=POLICY,...",
    "manager_gamma": "Discount per decision of the manager.",
    "by_ticks": "Discount by elapsed ticks instead of turns.",
    "practice": "Share of training in which the learning benches practise on their own; the manager learns afterwards.",
    "refund": "Share of training over which costs are refunded until a return is half of the payments; this fades.",
    "processed": "Share of training over which only vessels that were at a bench may be submitted; the rule fades.",
    "own_goals": "Share of training over which half of the laboratories start experiments for goals of their orders "
    "only; the rule fades.",
    "shown_readings": "Share of training over which vessels are measured automatically and free of charge; this fades.",
    "partial": "Share of training over which submissions that fail their specification are paid in part; this fades.",
    "free_readings": "Share of training over which the manager's measurements are refunded; the refund fades.",
    "self_imitation": "Weight of self-imitation: learning again from the manager's turns that beat its critic's "
    "estimate; 0 if manager_gamma is below 1.",
    "notes": "Give the manager notes of the episode as an observation. Default: where parameters are hidden.",
    "tied": "Share the manager's weights among slots, and among orders. Default: where parameters are hidden.",
}
"""Descriptions of arguments."""


class Arguments(BaseModel):
    """Arguments of every algorithm."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    scenario: str = "wurtz_dodecane"
    roles: Words | None = None
    algo: str = ""
    preset: str = "paper"
    background: str | None = None
    split: str = "train"
    steps: Many = 1_000_000
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    envs: Count = 10
    rollout: Turns = 256
    learning_rate: Positive = 3e-4
    gamma: Share = 0.99
    net_arch: Layers = (64, 64)
    evaluations: Count = 10
    eval_episodes: Count = 20
    final_episodes: Count = 100
    checkpoints: Count = 40

    @model_validator(mode="after")
    def _check_split(self) -> Self:
        from chemlab.config.draws import Split

        Split.of(self.split)
        return self

    @property
    def evaluation_split(self) -> str:
        """Split of the evaluations."""
        return "validation" if self.split == "train" else self.split

    @property
    def env_id(self) -> str:
        """Environment id, for cards and tables."""
        return "chemlab/Laboratory-v1"

    @property
    def label(self) -> str:
        """Name in figures and tables: algorithm, preset, or ``PRESET-ALGO`` for another algorithm than the preset's."""
        if self.preset == "paper":
            return self.algo
        is_usual = PRESETS[self.preset].get("algo", self.algo) == self.algo
        return self.preset if is_usual else f"{self.preset}-{self.algo}"

    def folder(self, label: str | None = None) -> Path:
        """Return a run's path below a folder of results: ``TASK/LABEL/seed-N``."""
        return Path(self._task_name(), label or self.label, f"seed-{self.seed}")

    def _task_name(self) -> str:
        return "-".join([Path(self.scenario).stem, *(self.roles or ("all",))])

    def stated(self) -> dict[str, Any]:
        """Return all arguments except the seed for ``config.json``, also defaults, because defaults may change."""
        return self.model_dump(mode="json", exclude={"seed"})

    @staticmethod
    def implied(values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the defaults that depend on other arguments."""
        return {}

    def unusual(self) -> list[str]:
        """Return the arguments whose values are not those of the preset or the defaults."""
        defaults = {name: field.default for name, field in type(self).model_fields.items()}
        usual = defaults | self.implied(self.__dict__) | PRESETS[self.preset]
        return [name for name in type(self).model_fields if getattr(self, name) != usual[name]]

    def flags(self) -> list[str]:
        """Return the options of ``chemlab train`` for these arguments, without the scenario."""
        words, given = [], self.unusual()
        for name in type(self).model_fields:
            value, option = getattr(self, name), f"--{name.replace('_', '-')}"
            if name == "scenario" or name not in {"algo", "steps", "seed", *given}:
                continue
            if isinstance(value, bool):
                words += [option if value else option.replace("--", "--no-")]
                continue
            for item in value if isinstance(value, tuple) else (value,):
                words += [option, str(item)]
        return words

    def command_line(self) -> str:
        """Return the command that repeats the run."""
        return shlex.join(["chemlab", "train", self.scenario, *self.flags()])


class Cloning(BaseModel):
    """Behaviour cloning before an on-policy algorithm learns."""

    bc: str | None = None
    bc_steps: Many = 20_000
    bc_rounds: Annotated[int, Field(ge=1, le=1000)] = 1

    @property
    def cloned(self) -> str | None:
        """Name of the policy that is cloned before learning."""
        return self.bc

    @model_validator(mode="after")
    def _check_cloning(self) -> Self:
        if self.cloned is None:
            for name in ("bc_steps", "bc_rounds", "bc_std"):
                if getattr(self, name, None) not in (None, type(self).model_fields.get(name, Field()).default):
                    raise ValueError(f"{name}: no policy is cloned; give bc, or leave it out")
        return self


class Single(Arguments):
    """One learner: a bench on its own, or one agent of a laboratory."""

    bench: str | None = None
    goals: Words | None = None
    actions: Literal["native", "discrete"] | None = None
    starts: str = "paper"
    curriculum: Words | None = None

    @model_validator(mode="after")
    def _check_task(self) -> Self:
        if self.bench is not None and self.roles is not None:
            raise ValueError("bench: trains a bench on its own, roles train in the laboratory; give one of them")
        if self.bench is None and (self.roles is None or len(self.roles) != 1 or self.roles[0] == "all"):
            given = ", ".join(self.roles or ("all",))
            raise ValueError(
                f"roles: {self.algo} trains one agent; give one (manager, rxn_0), or bench for a bench on its own, "
                f"or algo ippo or mappo for several; given {given}"
            )
        curriculum_of(self, ())
        return self

    @property
    def agent(self) -> str:
        """Id of the agent that learns in a laboratory."""
        (role,) = self.roles or ("manager",)
        return role if role.rpartition("_")[2].isdigit() else f"{role}_0"

    @property
    def env_id(self) -> str:
        """Environment id, for cards and tables."""
        if self.bench is None:
            return "chemlab/LabManager-v1" if self.agent == "manager_0" else "chemlab/LabAgent-v1"
        own = {"scenario": self.scenario, "bench": self.bench}
        return next((name for name, kwargs in _environments().items() if kwargs == own), _ANY_BENCH)

    def _task_name(self) -> str:
        name = self.env_id.removeprefix("chemlab/").rpartition("-v")[0]
        known = name not in ("Bench", "LabAgent", "LabManager")
        return name if known else f"{Path(self.scenario).stem}-{self.bench or self.agent}"


class OnPolicy(Single, Cloning):
    """PPO and A2C."""

    play: Play = "greedy"
    gae_lambda: Share = 0.95
    ent_coef: Weight = 0.0


class A2C(OnPolicy):
    """A2C."""

    algo: Literal["a2c"] = "a2c"
    learning_rate: Positive = 7e-4
    gae_lambda: Share = 1.0
    bc_std: Spread = 0.02


class Clipped(BaseModel):
    """Common arguments of all variants of PPO."""

    clip_range: Positive = 0.2
    epochs: Epochs = 10
    batch_size: Minibatch = 64


class SinglePPO(Clipped, OnPolicy):
    """Common arguments of the variants of PPO that train one agent."""

    @model_validator(mode="after")
    def _check_rollout(self) -> Self:
        steps = self.envs * self.rollout
        if steps < 2:
            raise ValueError("rollout: PPO needs at least 2 steps (envs x rollout) before each update, given 1")
        # Stable-Baselines3 does not normalize the advantage of a minibatch of one step; sb3-contrib does, to NaN.
        if self.algo != "ppo" and steps % self.batch_size == 1:
            raise ValueError(
                f"batch_size: a rollout of {steps} steps leaves a single step for the last minibatch of "
                f"{self.batch_size}, whose advantage cannot be normalized; give another batch_size or rollout"
            )
        return self


class PPO(SinglePPO):
    """PPO."""

    algo: Literal["ppo"] = "ppo"
    bc_std: Spread = 0.02


class Masked(SinglePPO):
    """PPO with masks of discrete actions, and teacher hints."""

    hints: str | None = None

    @property
    def cloned(self) -> str | None:
        """Name of the policy that is cloned before learning: ``bc``, or the policy of the hints."""
        return self.bc or self.hints

    @model_validator(mode="after")
    def _check_hints(self) -> Self:
        if self.hints is not None and self.bc not in (None, self.hints):
            raise ValueError(f"bc: hints are cloned, so it must be {self.hints!r}; leave it out")
        return self


class MaskablePPO(Masked):
    """PPO with masks of discrete actions."""

    algo: Literal["maskable-ppo"] = "maskable-ppo"


class Recurrent(SinglePPO):
    """PPO with an LSTM."""

    batch_size: Minibatch = 128
    memory: Annotated[int, Field(ge=1, le=65_536)] = 256


class RecurrentPPO(Recurrent):
    """PPO with an LSTM."""

    algo: Literal["recurrent-ppo"] = "recurrent-ppo"
    bc_std: Spread = 0.02


class MaskableRecurrentPPO(Recurrent, Masked):
    """PPO with an LSTM and masks of discrete actions."""

    algo: Literal["maskable-recurrent-ppo"] = "maskable-recurrent-ppo"


class Replay(Single):
    """Algorithms with replay memory."""

    batch_size: Minibatch = 256
    gradient_steps: Turns = 128
    buffer_size: Many = 1_000_000
    learning_starts: Annotated[int, BeforeValidator(_whole), Field(ge=0, le=10**12)] = 100


class DQN(Replay):
    """DQN."""

    algo: Literal["dqn"] = "dqn"
    learning_rate: Positive = 1e-4
    batch_size: Minibatch = 32
    gradient_steps: Turns = 256
    exploration_steps: Many = 30_000
    exploration_final: Share = 0.01


class QRDQN(DQN):
    """DQN with quantile regression (QR-DQN)."""

    algo: Literal["qr-dqn"] = "qr-dqn"  # type: ignore[assignment]
    learning_rate: Positive = 5e-5


class SAC(Replay):
    """SAC."""

    algo: Literal["sac"] = "sac"
    net_arch: Layers = (256, 256)
    ent_coef: Weight | None = None
    ent_coef_start: Positive = 1.0

    @model_validator(mode="after")
    def _check_entropy(self) -> Self:
        if self.ent_coef is not None and self.ent_coef_start != 1.0:
            raise ValueError("ent_coef_start: is the initial value of a learned weight; ent_coef fixes it")
        return self


class TD3(Replay):
    """TD3."""

    algo: Literal["td3"] = "td3"
    learning_rate: Positive = 1e-3
    net_arch: Layers = (400, 300)
    action_noise: Weight = 0.1


_HELP = ("refund", "processed", "own_goals", "shown_readings", "partial", "free_readings", "self_imitation")
"""Options against the manager's sparse reward, for learning from nothing; they never apply to evaluations."""
FOR_MANAGER, FOR_BENCHES = (*_HELP, "manager_gamma", "notes", "tied"), ("gamma", "practice")
"""Arguments of :class:`IPPO` without effect unless the manager, or a bench, learns."""


class IPPO(Clipped, Arguments, Cloning):
    """Roles of a laboratory that learn together, with a PPO for each; critics observe what their agent observes.

    The defaults are for learning from nothing: options against sparse reward, and small minibatches, which use each
    turn more often. Small minibatches would lower the score of a clone or of another initial policy, for which
    :meth:`implied` has other defaults.
    """

    algo: Literal["ippo"] = "ippo"
    bc_std: Spread = 0.02
    rewards: str | None = None
    regime: Literal["together", "in-turns"] = "together"
    period: Many = 10
    begin_from: str | None = None
    steps: Many = 250_000
    envs: Count = 256
    rollout: Turns | None = None  # type: ignore[assignment]
    learning_rate: Positive = 1e-3
    net_arch: Layers = (128, 128)
    manager_gamma: Share = 1.0
    by_ticks: bool = False
    gae_lambda: Share = 0.98
    ent_coef: Weight = 0.03
    epochs: Epochs = 3
    batch_size: Minibatch = 256
    eval_episodes: Count = 50
    play: Play = "better"
    practice: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.5
    refund: Share = 0.25
    processed: Share = 0.15
    own_goals: Share = 0.25
    shown_readings: Share = 0.15
    partial: Share = 0.3
    free_readings: Share = 0.8
    self_imitation: Weight = 1.0
    notes: bool | None = None
    tied: bool | None = None

    @staticmethod
    def implied(values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the defaults that depend on ``bc``, ``begin_from``, ``manager_gamma`` and ``regime``.

        Training from clones or policies has no options against sparse reward, no entropy bonus and small updates;
        from policies, it shares no weights. Self-imitation learns from undiscounted returns. With regime ``in-turns``,
        benches do not practise, because they would no longer learn in the laboratory.
        """
        if values.get("bc") is None and values.get("begin_from") is None:
            found = {} if values.get("manager_gamma", 1.0) == 1.0 else {"self_imitation": 0.0}
            return found if values.get("regime", "together") == "together" else {**found, "practice": 0.0}
        tied = {} if values.get("begin_from") is None else {"tied": False}
        steps = {"rollout": 128, "batch_size": 1024, "learning_rate": 1e-4}
        return {**dict.fromkeys((*_HELP, "practice"), 0.0), **steps, "ent_coef": 0.0, **tied}

    @model_validator(mode="before")
    @classmethod
    def _add_implied(cls, values: dict[str, Any]) -> dict[str, Any]:
        return {**cls.implied(values), **{name: value for name, value in values.items() if value is not None}}

    @model_validator(mode="after")
    def _check_weights(self) -> Self:
        if self.regime == "together" and self.period != type(self).model_fields["period"].default:
            raise ValueError("period: is for regime in-turns; leave it out")
        if self.self_imitation and self.manager_gamma < 1.0:
            raise ValueError(
                "self_imitation: learns from returns that are not discounted; leave it out, or manager_gamma"
            )
        if self.bc is not None and self.begin_from is not None:
            raise ValueError("bc: the clone would replace the policies of begin_from; leave one of them out")
        if self.tied and self.begin_from is not None:
            raise ValueError("tied: the policy of begin_from has weights of its own for each slot; leave it out")
        return self

    @property
    def label(self) -> str:
        """Name of the algorithm in figures and tables."""
        return super().label + ("" if self.regime == "together" else f"-{self.regime}")


class MAPPO(IPPO):
    """IPPO with critics that observe the laboratory's true state."""

    algo: Literal["mappo"] = "mappo"  # type: ignore[assignment]


ALGORITHMS: dict[str, type[Arguments]] = {
    str(kind.model_fields["algo"].default): kind
    for kind in (PPO, A2C, DQN, QRDQN, SAC, TD3, MaskablePPO, RecurrentPPO, MaskableRecurrentPPO, IPPO, MAPPO)
}
"""Models of arguments by the algorithm's name."""

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
    "manager": {**_MANAGER, "learning_rate": 3e-4, "bc": "scripted"},
    "manager-curriculum": {**_MANAGER, "learning_rate": 1e-3, "curriculum": ("backward",)},
    "ppo-xl": {"algo": "ppo", "envs": 32, "steps": 2_000_000},
    "sac-cool": {"algo": "sac", "ent_coef_start": 0.01},
}
"""Presets: the arguments that differ from the paper's protocol, by the preset's name."""

OLD_NAMES: dict[str, str] = {
    "imitate": "bc",
    "imitate_steps": "bc_steps",
}
"""Names of arguments in 0.2.0; accepted for one release."""


def load_arguments(path: Path | None, flags: Mapping[str, Any]) -> Arguments:
    """Read arguments from a TOML file and the flags of ``chemlab train``; flags take precedence.

    Raises:
        DataError: the file is missing or not TOML, or an argument is unknown or invalid.
    """
    where, values = ("train", {}) if path is None else (f"train --config {path}", read_toml(path))
    if {"bench", "roles"} & {*flags}:  # one excludes the other
        values = {name: value for name, value in values.items() if name not in ("bench", "roles")}
    return training_arguments({**values, **flags}, where)


def training_arguments(values: Mapping[str, Any], where: str = "arguments") -> Arguments:
    """Validate arguments with the model of their algorithm.

    Args:
        values: {name: value} as in a TOML table; an argument that is missing or None has its default.
        where: file or command, for errors.

    Raises:
        DataError: an argument is unknown, or a value has the wrong type or is out of bounds; the message names it.
    """
    given = _without_env_id(_with_current_names(values, where), where)
    preset = given.get("preset", "paper")
    if str(preset) not in PRESETS:
        raise DataError(f"{where}: preset: choose from {', '.join(PRESETS)}; given {shown(preset)}")
    given = {**PRESETS[preset], **given}
    roles = _several(given.get("roles", "all"))
    one = "bench" in given or (len(roles) == 1 and roles != ("all",))
    usual = "ppo" if one else "ippo"
    if roles in (("manager",), ("manager_0",)):
        usual = "ippo" if set(given) <= set(IPPO.model_fields) else "maskable-ppo"
    algo = given.get("algo", usual)
    if str(algo) not in ALGORITHMS:
        raise DataError(f"{where}: algo: choose from {', '.join(ALGORITHMS)}; given {shown(algo)}")
    kind, known = ALGORITHMS[algo], {name for model in ALGORITHMS.values() for name in model.model_fields}
    for name in given:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            raise DataError(f"{where}: {name}: unknown argument{f'; did you mean {near[0]}?' if near else ''}")
        if name not in kind.model_fields:
            users = ", ".join(own for own, model in ALGORITHMS.items() if name in model.model_fields)
            raise DataError(f"{where}: {name}: is for {users}, not for {algo}")
    return validated(kind, {**given, "algo": algo}, where)


def _with_current_names(values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the given arguments, with former names replaced by the current ones; a notice on stderr names each."""
    given = {name: value for name, value in values.items() if value is not None}
    for old, new in OLD_NAMES.items():
        if old in given:
            print(f"{where}: {old} is now called {new}; the old name ends with this release", file=sys.stderr)
            given.setdefault(new, given.pop(old))
    for name in ("background", "bc", "hints"):
        if isinstance(given.get(name), str):
            given[name] = current_name(given[name])
    return given


_ANY_BENCH = "chemlab/Bench-v1"


def _environments() -> dict[str, dict[str, str]]:
    """Return the keyword arguments of the registered environments of one agent, by id."""
    import gymnasium

    return {
        name: dict(spec.kwargs)
        for name, spec in gymnasium.registry.items()
        if spec.vector_entry_point and "chemlab." in str(spec.entry_point)
    }


def _without_env_id(given: dict[str, Any], where: str) -> dict[str, Any]:
    """Return arguments with the environment id, if there is one, replaced by its scenario and its bench or role."""
    env_id = given.pop("env_id", None)
    scenario = str(given.get("scenario", ""))
    if env_id is None and (scenario.startswith("chemlab/") or scenario == "manager"):
        env_id = given.pop("scenario")
    if env_id is None:
        return given
    env_id = "chemlab/LabManager-v1" if env_id == "manager" else env_id
    known = _environments()
    if str(env_id) not in known:
        raise DataError(f"{where}: scenario: environments are {', '.join(known)}; given {shown(env_id)}")
    fixed = {} if env_id == _ANY_BENCH else known[env_id]  # that one exists for every scenario and bench
    for name, value in fixed.items():
        other = given.get("bench" if name == "agent" else name, value)
        if other != value:
            raise DataError(f"{where}: {name}: {env_id} has {value!r}, given {shown(other)}; name the scenario instead")
    bench = given.pop("bench", None)
    bench = fixed.get("bench", fixed.get("agent", bench))
    given = {"scenario": fixed.get("scenario", "wurtz_dodecane"), **given}
    return {"roles": bench or "manager_0", **given} if "Lab" in env_id else {**given, "bench": bench or "rxn"}


class Stage(NamedTuple):
    """A stage of a curriculum.

    Attributes:
        until: training step at which the stage ends.
        shares: share of the episodes by the bench for which their first vessel is ready, or ``submit``.
    """

    until: int
    shares: dict[str, float]


BACKWARD = "backward"
_BACKWARD_SHARE = 0.6
"""Share of a run's steps that the stages of ``backward`` take."""


def curriculum_of(arguments: Single, benches: Sequence[str]) -> list[Stage]:
    """Return the stages of a run's curriculum in order.

    After the last stage, all episodes begin with the scenario's own shelf. ``backward`` has a stage for each bench,
    from the last of the workflow to the first: each adds one kind of initial state, and all kinds so far are equally
    frequent.

    Args:
        arguments: arguments of the run.
        benches: benches of the scenario in the order of the workflow.

    Raises:
        ValueError: a stage that cannot be parsed, or stages out of order.
    """
    stages: list[Stage] = []
    for text in arguments.curriculum or ():
        if text == BACKWARD:
            for new in range(1, len(benches) + 1):
                ready = ["submit", *reversed(benches)][: new + 1]
                end = int(arguments.steps * _BACKWARD_SHARE * new / len(benches))
                stages.append(Stage(end, dict.fromkeys(ready, 1.0 / (new + 1))))
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


def recorded_arguments(config: dict[str, Any], where: str) -> Arguments:
    """Return the arguments of a run; arguments that its configuration does not state have their defaults.

    Args:
        config: content of its ``config.json``.
        where: path of that file, for error messages.

    Raises:
        DataError: the run is from a version before 0.3, or its arguments are invalid in this version.
    """
    if not isinstance(config.get("arguments"), dict):
        raise DataError(f"{where}: was made by a version before 0.3; train it again")
    return training_arguments({**config["arguments"], "seed": config.get("seed")}, where)


def filled(config: dict[str, Any]) -> dict[str, Any]:
    """Return a run's ``config.json`` with the defaults of newer arguments; unchanged if the arguments are invalid."""
    try:
        return {**config, "arguments": recorded_arguments(config, "").stated()}
    except DataError:
        return config
