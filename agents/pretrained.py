"""Trained policies that need only NumPy: a ``NAME.safetensors`` file with the weights and a ``NAME.json`` card.

>>> from chemlab.agents.pretrained import load_pretrained, pretrained_names
>>> policy = load_pretrained("wurtz_rxn")                                          # doctest: +SKIP

A policy fits a bench, or a laboratory's manager, with the same channels, goals and actions, independent of the
scenario's name. A card states the task, training, command and evaluation of a policy.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.resources
import itertools
import json
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, Field, field_validator
from safetensors.numpy import load, save

from chemlab.config.datafile import DataError, read_json
from chemlab.config.datamodel import DataModel, validated, written
from chemlab.config.files import read_bytes, write_bytes, write_json
from chemlab.envs.players import Actions, Memory, Policy, Remembering
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.roles.base import Workplace
from chemlab.roles.bench import Bench
from chemlab.roles.kinds import discretised_twin

from .discretised import ChoosingPolicy
from .former_names import SAMPLED
from .notes import notes_size
from .random_policy import RandomPolicy

Weights = Mapping[str, npt.NDArray[np.float32]]
Seed = int | np.random.SeedSequence | None

_MOST_BYTES = 256_000_000
_MOST_LAYERS = 32

LSTM = {"lstm.weight_ih": ("4H", "O"), "lstm.weight_hh": ("4H", "H"), "lstm.bias": ("4H",)}
"""Shapes by name of the weights of an LSTM with H units and O inputs."""
LOG_STD = "log_std"
"""Name of the logarithms of the standard deviations [n] of continuous actions, which sampling needs."""
_Q_LEARNERS = ("dqn", "qr-dqn")
"""Algorithms whose outputs are action values, not logits."""


class Interface(DataModel):
    """Channels and actions of an agent as plain values; a policy fits an agent with an equal interface."""

    model_config = ConfigDict(strict=True)

    kind: str
    channels: list[Annotated[list[str | int | float], Field(min_length=6, max_length=6)]]
    actions: list[str]
    discrete: bool

    @field_validator("actions")
    @classmethod
    def _present_units(cls, actions: list[str]) -> list[str]:
        """Return the actions of a card that was written when magnitudes had other units as they are named now."""
        words = [re.sub(r"(?<= )clock$", "units of settling time", action) for action in actions]
        return [re.sub(r"(\S+) fraction$", lambda share: f"{100.0 * float(share[1]):g} %", one) for one in words]


def interface(workplace: Workplace) -> Interface:
    """Return the interface of an agent."""
    return Interface(
        kind=workplace.kind,
        channels=[[c.name, c.size, c.unit, c.low, c.high, c.meaning] for c in workplace.channels],
        actions=list(workplace.action_meanings),
        discrete=bool(workplace.action_count),
    )


def fingerprint(workplace: Workplace) -> str:
    """Return a hash of the task.

    For a bench, it covers options, initial state, chemistry, stock and prices; for a manager, these of all benches, the
    shelf, instruments, limits and costs.
    """
    scenario = workplace.scenario
    task: dict[str, Any] = {
        "materials": {name: written(m) for name, m in scenario.materials.items()},
        "family": written(scenario.family),
        "goals": scenario.goals,
        "stock": scenario.stock,
        "ambient": [scenario.ambient_temperature_k, scenario.ambient_pressure_kpa],
        "safety": written(scenario.safety),
        "illegal_action": scenario.costs.illegal_action,
    }
    if isinstance(workplace, Bench):
        task["bench"] = written(workplace.spec, without={"count"})
    else:
        task["laboratory"] = written(scenario, without={"name", "title", "summary"})
    return hashlib.sha256(json.dumps(task, sort_keys=True).encode()).hexdigest()[:16]


class Card(DataModel):
    """Card of a policy, ``NAME.json``.

    Attributes:
        name: name of the policy.
        env_id, scenario, goals, starts: training task.
        bench: role: a bench's key, or ``manager``.
        fingerprint: hash of the task (:func:`fingerprint`).
        interface: channels and actions (:func:`interface`).
        observation_size: length of an observation.
        action_size: number of discrete actions, or length of a continuous action.
        algo, label, seed, step: the algorithm, its label, the run's seed, and the checkpoint's step.
        command: command that repeats the training.
        versions: versions of chemlab, Stable-Baselines3, PyTorch, numpy.
        activation: activation of the hidden layers, ``tanh`` or ``relu``.
        output: ``argmax`` (of the legal actions), ``clip`` (to [0, 1]) or ``tanh`` (rescaled to [0, 1]).
        evaluation: ``episodes_per_goal``, ``seed``, ``mean``, ``by_goal`` of the policy as played here, with masks, and
            ``scripted_mean``, ``scripted_by_goal`` of the scripted policy.
        background: policy of the roles that did not learn, if trained in a laboratory.
        memory: number of units of the LSTM before the layers; 0: none.
        masked: True if it chooses among legal actions only; False if it was trained without masks.
        advice: name of the policy whose action it observes (:mod:`chemlab.agents.advice`), if any.
        sampled: True if actions are drawn from its distribution by default; False if the most probable one is played.
        notes: True if its notes of the episode (:mod:`chemlab.agents.notes`) are the last part of its observation.
    """

    model_config = ConfigDict(strict=True)

    name: str = Field(min_length=1)
    env_id: str
    scenario: str
    bench: str = Field(min_length=1)
    goals: list[str]
    starts: str
    fingerprint: str
    interface: Interface
    observation_size: int = Field(ge=1)
    action_size: int = Field(ge=1)
    algo: str
    label: str
    seed: int
    step: int
    command: str
    versions: dict[str, str]
    activation: Literal["tanh", "relu"]
    output: Literal["argmax", "clip", "tanh"]
    evaluation: dict[str, Any]
    background: str | None = None
    masked: bool = True
    memory: int = Field(default=0, ge=0, le=65_536)
    advice: str | None = None
    sampled: bool = False
    notes: bool = False

    @classmethod
    def of(cls, workplace: Workplace, **more: Any) -> Card:
        """Return the card of a policy trained for a workplace; ``more`` are the other fields."""
        fields: dict[str, Any] = {
            "scenario": workplace.scenario.name,
            "bench": workplace.key,
            "fingerprint": fingerprint(workplace),
            "interface": interface(workplace),
            "observation_size": int(workplace.observation_space.shape[0]),
            "action_size": workplace.action_count or len(workplace.action_meanings),
        }
        if more.get("advice") is not None:
            fields["observation_size"] += fields["action_size"]
        if more.get("notes"):
            fields["observation_size"] += notes_size(workplace)
        return cls(**{**fields, **more})


class PretrainedPolicy(Remembering):
    """A trained network as a :class:`~chemlab.envs.players.Policy`, with a memory if it has an LSTM.

    It plays greedily, or sampled if its card says so. The drawn actions of a sampled policy depend on its seed only.

    Args:
        card: the policy's card.
        weights: ``{i}.weight`` [out, in] and ``{i}.bias`` [out] of the layers, in order; with a memory of H units also
            :data:`LSTM`, gates in PyTorch's order (input, forget, cell, output); :data:`LOG_STD`, if there is one.
        seed: seed of the drawn actions.

    Raises:
        ValueError: weights and card do not agree.
    """

    _MEMORY = ("_memory", "_draws")

    def __init__(self, card: Card, weights: Weights, seed: Seed = None) -> None:
        self.card, self.weights = card, weights
        hidden, actions = card.memory, card.action_size
        axes = {"O": card.observation_size, "H": hidden, "4H": 4 * hidden}
        shapes = {name: tuple(axes[axis] for axis in shape) for name, shape in LSTM.items() if hidden}
        shapes |= {LOG_STD: (actions,)} if LOG_STD in weights else {}
        depth = min((len(weights) - len(shapes)) // 2, _MOST_LAYERS)
        expected = {f"{i}.{part}" for i in range(depth) for part in ("weight", "bias")} | set(shapes)
        if set(weights) != expected or not depth:
            raise ValueError(
                f"{card.name}: weights must be 0.weight, 0.bias, 1.weight, ... of {_MOST_LAYERS} layers at most; found "
                f"{sorted(weights)!s:.500}"
            )
        sizes = [hidden or card.observation_size, *(weights[f"{i}.bias"].size for i in range(depth - 1)), actions]
        for i in range(depth):
            shapes |= {f"{i}.weight": (sizes[i + 1], sizes[i]), f"{i}.bias": (sizes[i + 1],)}
        for name, shape in shapes.items():
            given = weights[name]
            if given.shape != shape or given.dtype.kind != "f":
                raise ValueError(
                    f"{card.name}: {name}: must be numbers of shape {shape}, given {given.dtype} of {given.shape}: "
                    "the card and the weights do not belong together"
                )
            if not np.isfinite(given).all():
                raise ValueError(
                    f"{card.name}: {name}: must be finite; if you trained it, training has diverged: "
                    "give a lower learning_rate"
                )
        self._lstm = [weights[name].astype(np.float64) for name in LSTM] if hidden else []
        self._memory = Memory(hidden, hidden)
        self._layers = [
            (weights[f"{i}.weight"].T.astype(np.float64, order="C"), weights[f"{i}.bias"].astype(np.float64))
            for i in range(depth)
        ]
        self._std = np.exp(weights.get(LOG_STD, np.zeros(actions)).astype(np.float64))
        self._draws = RandomPolicy(1 if card.output == "argmax" else actions, seed) if card.sampled else None
        obstacle = card.sampled and self._obstacle()
        if obstacle:
            raise ValueError(f"{card.name}: cannot be sampled: {obstacle}; play it greedily")

    def _obstacle(self) -> str:
        """Return the reason why the policy cannot be sampled; empty if it can."""
        if self.card.output == "argmax":
            return f"{self.card.algo} learns values of actions" if self.card.algo in _Q_LEARNERS else ""
        return "" if self.card.output == "clip" and LOG_STD in self.weights else f"it has no {LOG_STD}"

    def as_played(self, way: str | None, seed: Seed = None) -> PretrainedPolicy:
        """Return a greedy or sampled copy of the policy.

        Args:
            way: :data:`~.former_names.GREEDY`, :data:`~.former_names.SAMPLED` or None (as its card says).
            seed: seed of the drawn actions.

        Raises:
            ValueError: the policy cannot be sampled.
        """
        sampled = self.card.sampled if way is None else way == SAMPLED
        return PretrainedPolicy(self.card.model_copy(update={"sampled": sampled}), self.weights, seed)

    def seed(self, member: int, seed: int | np.random.SeedSequence) -> None:
        """Restart the random stream of one environment."""
        if self._draws is not None:
            self._draws.seed(member, seed)

    def check(self, workplace: Workplace) -> None:
        """Check that the policy fits a workplace; warn if the task has changed since training.

        Raises:
            ValueError: it does not fit; the message states the first difference and what to do.
        """
        difference = _difference(self.card, workplace)
        if difference:
            raise ValueError(
                f"pretrained {self.card.name!r} does not fit {workplace.key!r} of {workplace.scenario.name}: "
                f"{difference}; train one for it: {_training_command(workplace)}"
            )
        same = (self.card.scenario, self.card.bench) == (workplace.scenario.name, workplace.key)
        if same and self.card.fingerprint != fingerprint(workplace):
            warnings.warn(
                f"pretrained {self.card.name!r}: {workplace.key!r} of {workplace.scenario.name} has changed since it "
                f"was trained, so that it may do worse than its card says; train it again: {self.card.command}",
                stacklevel=2,
            )

    def values(
        self, observation: ObservationArray, step: IntArray | None = None, members: IntArray | None = None
    ) -> npt.NDArray[np.float32]:
        """Return the outputs of the network [B, actions]: logits or Q values of discrete actions, or the mean action.

        Args:
            observation: [B, size] observations.
            step, members: as for :meth:`act`; needed by a policy with a memory, which is updated. Default: first turns.

        Raises:
            ValueError: observations have another size.
        """
        x = np.asarray(observation, dtype=np.float32)
        if x.ndim != 2 or x.shape[1] != self.card.observation_size:
            raise ValueError(
                f"pretrained {self.card.name!r} observes [B, {self.card.observation_size}] numbers, given {x.shape}; "
                "check() states the difference"
            )
        # The last digits of sums of products depend on the batch size and the memory layout. Twice the precision
        # removes these differences, which matter when two actions have nearly equal values.
        y = x.astype(np.float64)
        if self._lstm:
            first = np.zeros(len(y), dtype=np.int64)
            y = self._lstm_output(y, first if step is None else step, np.arange(len(y)) if members is None else members)
        for i, (weight, bias) in enumerate(self._layers):
            y = y @ weight + bias
            if i < len(self._layers) - 1:
                y = np.tanh(y) if self.card.activation == "tanh" else np.maximum(y, 0.0)
        return y.astype(np.float32)

    def _lstm_output(self, x: FloatArray, step: IntArray, members: IntArray) -> FloatArray:
        """Return the output of the LSTM [B, H], and update its memory."""
        from scipy.special import expit  # imported on use, because the import is slow

        hidden, cell = self._memory.recall(step, members)
        input_weights, hidden_weights, bias = self._lstm
        gates = x @ input_weights.T + hidden @ hidden_weights.T + bias
        input_gate, forget_gate, candidate, output_gate = np.split(gates, 4, axis=1)
        cell = expit(forget_gate) * cell + expit(input_gate) * np.tanh(candidate)
        hidden = expit(output_gate) * np.tanh(cell)
        self._memory.keep(members, hidden, cell)
        return hidden

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`. Without a mask, all discrete actions are legal."""
        values = self.values(observation, step, members)
        drawn = None if self._draws is None else self._draws.act(observation, None, step, members)
        if self.card.output == "argmax":
            if mask is not None and self.card.masked:
                values = np.where(np.asarray(mask) != 0, values, -np.inf)
            return np.asarray(values.argmax(axis=1) if drawn is None else _drawn(values, drawn), dtype=np.int64)
        if drawn is not None:
            from scipy.special import ndtri  # imported on use, because the import is slow

            return np.asarray(np.clip(values + self._std * ndtri(drawn), 0.0, 1.0))
        if self.card.output == "tanh":
            values = np.float32(0.5) * (np.tanh(values) + np.float32(1.0))
        return np.clip(values, 0.0, 1.0).astype(np.float64)


def _drawn(logits: npt.NDArray[np.float32], uniform: FloatArray) -> IntArray:
    """Return actions [B] sampled from logits [B, A] by uniform numbers [B, 1]."""
    cumulated = np.exp((logits - logits.max(axis=1, keepdims=True)).astype(np.float64)).cumsum(axis=1)
    total = cumulated[:, -1:]
    return np.asarray((cumulated <= np.minimum(uniform * total, np.nextafter(total, 0.0))).sum(axis=1))


def fitted(policy: PretrainedPolicy, workplace: Workplace) -> Policy:
    """Return a policy adapted to a workplace: choices of a discretised bench are converted to continuous actions.

    Raises:
        ValueError: it does not fit, see :meth:`PretrainedPolicy.check`.
    """
    twin = discretised_twin(workplace) if isinstance(workplace, Bench) and policy.card.interface.discrete else None
    policy.check(workplace if twin is None else twin)
    return policy if twin is None else ChoosingPolicy(policy, twin.action_rows)


def _training_command(workplace: Workplace) -> str:
    """Return the commands that train and export a policy for a workplace."""
    role = f"--bench {workplace.key}" if isinstance(workplace, Bench) else "--roles manager"
    return f"chemlab train {workplace.scenario.argument} {role}, then chemlab export"


def _difference(card: Card, workplace: Workplace) -> str:
    """Describe the first difference between a workplace and the policy's interface; empty if there is none."""
    trained, present = card.interface, interface(workplace)
    if trained.kind != present.kind:
        return f"it is for {trained.kind}, this is {present.kind}"
    size = int(workplace.observation_space.shape[0]) + (card.action_size if card.advice is not None else 0)
    size += notes_size(workplace) if card.notes else 0
    for old, new in zip(trained.channels, present.channels, strict=False):
        if old != new:
            return f"observation {old[0]!r}: it was trained with {old[1:]}, here {new[0]!r} is {new[1:]}"
    if card.observation_size != size:
        return f"it observes {card.observation_size} numbers, here there are {size}"
    if trained.actions != present.actions:
        pairs = itertools.zip_longest(trained.actions, present.actions)
        first = next(i for i, (old_action, new_action) in enumerate(pairs) if old_action != new_action)
        return (
            f"it has {len(trained.actions)} actions, here there are {len(present.actions)}; they differ from {first} on"
        )
    return ""


def _shipped() -> Path:
    # The folder is beside this module in a checkout and in an installed wheel.
    return Path(str(importlib.resources.files(__package__ or "chemlab.agents") / "models"))


def pretrained_names() -> list[str]:
    """Return the names of the bundled policies."""
    return sorted(file.stem for file in _shipped().glob("*.json"))


def _read_card(path: Path) -> Card:
    if not path.exists():
        raise DataError(f"{path}: no such card; bundled policies: {', '.join(pretrained_names()) or 'none'}")
    return validated(Card, read_json(path), f"{path}: not a card of this version")


# Bundled cards do not change, and a command may read all of them hundreds of times.
_bundled = functools.cache(_read_card)


def pretrained_files(name_or_path: str | Path) -> tuple[Path, Path]:
    """Return the paths of a policy's card and weights, by its name or the path of either, with or without a suffix."""
    path = Path(name_or_path)
    if isinstance(name_or_path, str) and name_or_path in pretrained_names():
        path = _shipped() / name_or_path
    if path.suffix in (".json", ".safetensors"):
        path = path.with_suffix("")
    return path.with_name(f"{path.name}.json"), path.with_name(f"{path.name}.safetensors")


def load_pretrained(name_or_path: str | Path) -> PretrainedPolicy:
    """Load a policy by its name (:func:`pretrained_names`) or by the path of either of its files.

    Raises:
        ValueError: the name is unknown, or files are missing or damaged.
    """
    card_file, file = pretrained_files(name_or_path)
    card = _read_card(card_file)
    try:
        weights = load(read_bytes(file, _MOST_BYTES))
    except Exception as error:  # safetensors has its own exception class, which is not public
        raise DataError(f"{file}: cannot be read ({error!s:.500}); it belongs beside {card_file.name}") from error
    try:
        return PretrainedPolicy(card, weights)
    except ValueError as error:
        raise DataError(f"{file}: {error}") from error


def save_policy(path: Path, card: Card, weights: Weights) -> None:
    """Write ``PATH.safetensors`` and ``PATH.json`` atomically, and read them back.

    Args:
        path: path of both files, without suffix.
        card: the card.
        weights: as for :class:`PretrainedPolicy`.

    Raises:
        ValueError: weights and card do not agree.
    """
    PretrainedPolicy(card, weights)
    write_bytes(path.with_name(f"{path.name}.safetensors"), save(dict(weights)))
    write_json(path.with_name(f"{path.name}.json"), card.model_dump())
    load_pretrained(path)


def pretrained_for(workplace: Workplace, laboratory: bool = False, alone: bool = False) -> PretrainedPolicy:
    """Return the bundled policy for a workplace: one trained on it, else one with the same interface.

    Args:
        workplace: the bench or manager.
        laboratory: True if it is in a laboratory: policies trained in a running laboratory are preferred, otherwise
            policies trained on a single bench. The next criteria are an equal scenario and bench, and training on the
            vessels of a laboratory.
        alone: True to prefer policies trained on a single bench in a laboratory as well.

    Raises:
        ValueError: no policy fits. The message has the reason for one of the same kind, if possible of this scenario.
    """
    reasons, fitting = [], []
    for name in pretrained_names():
        card = _bundled(_shipped() / f"{name}.json")
        if card.interface.kind != workplace.kind:
            continue
        difference = _difference(card, workplace)
        if difference:
            reasons.append((card.scenario != workplace.scenario.name, f"{name}: {difference}"))
        else:
            elsewhere = (card.scenario, card.bench) != (workplace.scenario.name, workplace.key)
            other = (card.background is None) == (laboratory and not alone)
            fitting.append((other, elsewhere, (card.starts == "paper") == laboratory, name))
    if not fitting:
        reason = min(reasons)[1] if reasons else f"none for {workplace.kind} is bundled"
        more = f"; others that do not fit: {len(reasons) - 1}" if len(reasons) > 1 else ""
        raise ValueError(
            f"no pretrained policy fits {workplace.key!r} of {workplace.scenario.name} ({reason}{more}); "
            f"train one: {_training_command(workplace)}"
        )
    policy = load_pretrained(min(fitting)[-1])
    policy.check(workplace)
    return policy
