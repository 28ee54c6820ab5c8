"""Verbs of a role: its actions as functions with named arguments, generated from the scenario."""

from __future__ import annotations

import contextlib
import functools
import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from chemlab.lab.engine import Laboratories
from chemlab.roles.bench import Bench
from chemlab.roles.operation_bench import OperationBench

from .roles import action_size

_MOST_TEXT = 60
"""Maximum length of a given value in an error message."""


class ToolError(ValueError):
    """A call was refused and has changed nothing; the message names the accepted calls."""


def plain(value: Any, most: int = _MOST_TEXT) -> str:
    """Return a value as printable text of at most ``most`` characters."""
    try:
        text = value if isinstance(value, str) else repr(value)
    except Exception:  # a class of the caller may raise anything
        text = f"<{type(value).__name__}>"
    text = "".join(character if character.isprintable() else " " for character in text[: most + 1])
    return text if len(text) <= most else text[: most - 3] + "..."


def number_of(value: Any) -> float | None:
    """Return a finite number that is given as a number or as text; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def amount_of(value: Any) -> str:
    """Describe a value in an error message about text: its length, or the value if it is not text."""
    return f"{len(value)} characters" if isinstance(value, str) else plain(value)


@dataclass(frozen=True)
class Argument:
    """An argument of a verb: one of several options, a number from ``low`` to ``high``, or a text.

    Attributes:
        name: name of the argument.
        meaning: description for people and models.
        options: accepted values, strings or integers; empty: any number in the range.
        low: smallest number.
        high: largest number.
        default: default value; None: the argument is required.
        longest: maximum length of a text; 0: the argument is not a text.
    """

    name: str
    meaning: str
    options: tuple[str | int, ...] = ()
    low: float = 0.0
    high: float = 1.0
    default: str | int | float | None = None
    longest: int = 0

    def checked(self, verb: str, value: Any) -> str | int | float:
        """Return the accepted value that is equal to ``value`` as a number or as text: 1 for ``"1"``, for example.

        Raises:
            ToolError: the value is not accepted.
        """
        if self.longest:
            if isinstance(value, str) and value.strip() and len(value) <= self.longest:
                return plain(value, self.longest)
            raise ToolError(
                f"{verb}: {self.name} must be a text of 1 to {self.longest} characters, given {amount_of(value)}"
            )
        number = number_of(value)
        for option in self.options:
            same_text = isinstance(value, str) and value.strip() == str(option)
            if same_text or (number is not None and number == number_of(option)):
                return option
        if not self.options and number is not None and self.low <= number <= self.high:
            return number
        accepted = f"a number from {self.low:g} to {self.high:g}"
        if self.options:
            accepted = f"one of {', '.join(map(str, self.options))}"
        raise ToolError(f"{verb}: {self.name} must be {accepted}; given {plain(value)}")


@dataclass(frozen=True)
class Verb:
    """A verb of a role.

    Attributes:
        name: name of the verb.
        meaning: description in one sentence.
        arguments: arguments in order.
        action: function of the checked arguments that returns the action, or raises :class:`ToolError` if the
            combination does not exist. None: the verb is not an action of the laboratory.
        fixed: arguments with one possible value, which may be omitted.
    """

    name: str
    meaning: str
    arguments: tuple[Argument, ...] = ()
    action: Callable[[Mapping[str, Any]], Any] | None = None
    fixed: tuple[Argument, ...] = ()

    @classmethod
    def of(cls, name: str, meaning: str, arguments: Sequence[Argument], action: Callable[..., Any]) -> Verb:
        """Return a verb whose arguments with one possible value may be omitted."""
        free = tuple(argument for argument in arguments if len(argument.options) != 1)
        return cls(name, meaning, free, action, tuple(argument for argument in arguments if argument not in free))

    @property
    def takes(self) -> str:
        """Number and names of the arguments, as the predicate of a sentence."""
        names = [argument.name for argument in self.arguments]
        if not names:
            return "takes no arguments"
        return f"takes {len(names)} argument{'' if len(names) == 1 else 's'} ({', '.join(names)})"

    def ways(self) -> Iterator[tuple[dict[str, Any], Any]]:
        """Yield the arguments and the action of every call; nothing if an argument is a number or a text."""
        if self.action is None:
            return
        for values in itertools.product(*(argument.options for argument in self.arguments)):
            given = {argument.name: value for argument, value in zip(self.arguments, values, strict=True)}
            with contextlib.suppress(ToolError):  # these do not go together
                yield given, self.action(given)

    def checked(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of all arguments, checked, with defaults.

        Raises:
            ToolError: an argument is unknown, missing or wrong.
        """
        for argument in self.fixed:
            if argument.name in given:
                argument.checked(self.name, given[argument.name])
        known = {argument.name for argument in (*self.arguments, *self.fixed)}
        unknown = [plain(key) for key in given if key not in known]
        if unknown:
            raise ToolError(f"{self.name}: unknown argument {unknown[0]}; it {self.takes}")
        values = {}
        for argument in self.arguments:
            if argument.name in given:
                values[argument.name] = argument.checked(self.name, given[argument.name])
            elif argument.default is not None:
                values[argument.name] = argument.default
            else:
                raise ToolError(f"{self.name}: {argument.name} is missing; it {self.takes}")
        return values


_MANAGER = {
    "start": "Bring the vessel of a slot to a bench and begin an experiment there.",
    "measure": "Measure the vessel of a slot with an instrument, at its price.",
    "discard": "Throw away the vessel of a slot.",
    "submit": "Deliver the vessel of a slot for an order.",
    "recall": "End the experiment at a bench; its vessels come back to the shelf.",
    "wait": "Let the benches work until an experiment ends or there is news.",
    "calibrate": "Calibrate an instrument.",
    "repair": "Have a bench repaired.",
}
_ARGUMENTS = {
    "bench": "the bench",
    "slot": "the slot of the shelf",
    "goal": "the material that the experiment is for",
    "grade": "the quality that is asked for",
    "instrument": "the instrument",
    "order": "the order",
}


def manager_verbs(labs: Laboratories, name: Callable[[str], str]) -> list[Verb]:
    """Return the manager's verbs; ``name`` returns the name that the seat uses for a material."""
    actions = labs.actions
    goal_of = {name(goal): goal for goal in labs.scenario.goals}
    goals = tuple(sorted(goal_of) if name is not str else goal_of)
    arguments = {
        kind: [Argument(key, _ARGUMENTS[key], goals if key == "goal" else values) for key, values in spaces.items()]
        for kind, spaces in actions.arguments.items()
        if all(spaces.values())
    }

    def encode(kind: str, given: Mapping[str, Any]) -> int:
        values = [given.get(a.name, a.options[0]) for a in arguments[kind]]
        return actions.encode(kind, *(goal_of.get(value, value) for value in values))

    return [
        Verb.of(kind, meaning, arguments[kind], functools.partial(encode, kind))
        for kind, meaning in _MANAGER.items()
        if kind in arguments
    ]


_OPERATIONS = {
    "drain": "Drain the lowest part of a vessel into another one.",
    "mix": "Stir a vessel.",
    "pour": "Pour a share of a vessel into another one.",
    "add": "Add a material from stock.",
    "settle": "Let all vessels at the bench settle.",
    "heat": "Heat a vessel, or cool it where the amount is below 0; vapour condenses into the receiver.",
    "seed": "Add seed crystals.",
    "filter": "Filter a share of the liquid into another vessel.",
    "dry": "Dry a vessel with air.",
}


def bench_verbs(bench: Bench, name: Callable[[str], str]) -> list[Verb]:
    """Return the verbs of a bench's agent; ``name`` returns the name that the seat uses for a material."""
    if isinstance(bench, OperationBench):
        return _operation_verbs(bench, name)
    if bench.action_count:
        meanings = [_renamed(bench, words, name) for words in bench.action_meanings]
        choice = Argument("action", "what to do", tuple(dict.fromkeys(meanings)))
        return [Verb("choose", "Take one step.", (choice,), lambda given: meanings.index(given["action"]))]
    return [_continuous_verb(bench, name)]


def _renamed(bench: Bench, words: str, name: Callable[[str], str]) -> str:
    """Return an action's description with the names that the seat uses for materials."""
    if name is str:
        return words
    materials = sorted(bench.scenario.materials, key=len, reverse=True)
    pattern = "|".join(rf"(?<![\w-]){re.escape(material)}(?![\w-])" for material in materials)
    return re.sub(pattern, lambda match: name(match[0]), words)


def _operation_verbs(bench: OperationBench, name: Callable[[str], str]) -> list[Verb]:
    """Return a verb for each kind of process in the bench's table, and ``end``."""
    rows: dict[str, dict[tuple[Any, ...], int]] = {}
    units: dict[str, str] = {}
    actions = [(process, magnitude) for process in bench.options.process for magnitude in process.magnitudes]
    for index, (process, magnitude) in enumerate(actions):
        kind = process.kind.rpartition(":")[2].lower()
        material = process.material and name(process.material)
        rows.setdefault(kind, {})[process.vessel, process.target, material, f"{magnitude:.15g}"] = index
        units[kind] = bench.units[process.kind]
    verbs = [_operation_verb(kind, table, units[kind]) for kind, table in rows.items()]
    return [*verbs, Verb("end", "End the experiment.", (), lambda given: bench.end_action)]


def _operation_verb(kind: str, rows: Mapping[tuple[Any, ...], int], unit: str) -> Verb:
    """Return the verb of one kind of process; ``rows`` are actions by (vessel, target, material, amount)."""
    parts = {"vessel": "the vessel", "target": "the vessel that receives", "material": "the material"}
    arguments: list[Argument | None] = []
    for k, (part, meaning) in enumerate({**parts, "amount": f"how much ({unit})"}.items()):
        values = list(dict.fromkeys(row[k] for row in rows if row[k] is not None))
        integers = part == "amount" and all(float(value).is_integer() for value in values)
        options = tuple(int(value) if integers else value for value in values)
        arguments.append(Argument(part, meaning, options) if options else None)

    def action(given: Mapping[str, Any]) -> int:
        chosen = tuple(None if a is None else str(given.get(a.name, a.options[0])) for a in arguments)
        if chosen not in rows:
            ways = dict.fromkeys(tuple(str(part) for part in row[:3] if part is not None) for row in rows)
            raise ToolError(f"{kind}: these do not go together; possible: {'; '.join(' '.join(way) for way in ways)}")
        return rows[chosen]

    known = [argument for argument in arguments if argument is not None]
    return Verb.of(kind, _OPERATIONS.get(kind, f"{kind.capitalize()}."), known, action)


def _continuous_verb(bench: Bench, name: Callable[[str], str]) -> Verb:
    """Return the verb of a continuous bench, with its numbers in physical units. The default is no change."""
    reagents: Sequence[str] = getattr(bench, "reagent_names", ())
    if not reagents:
        numbers = [Argument(f"number_{i}", words, default=0.5) for i, words in enumerate(bench.action_meanings)]
        return Verb("step", "Take one step.", tuple(numbers), lambda given: np.array([given[n.name] for n in numbers]))
    steps = [bench.options.temperature_k.step, bench.options.volume_l.step]
    changes = []
    for what, unit, most, words in zip(("temperature", "volume"), "KL", steps, bench.action_meanings, strict=False):
        changed, _, effect = words.partition(": ")
        range_words = f"change of the {changed} in {unit}, {-most:g} to {most:g}"
        meaning = words if effect.startswith("no effect") else range_words
        changes.append(Argument(f"{what}_change", meaning, (), -most, most, 0.0))
    additions = [
        Argument("add_" + re.sub(r"\W", "_", name(one)), f"share of the {name(one)} that is left, 0 to 1", default=0.0)
        for one in reagents
    ]

    def action(given: Mapping[str, Any]) -> Any:
        changed = [0.5 + 0.5 * float(given[one.name]) / step for one, step in zip(changes, steps, strict=True)]
        added = [float(given[one.name]) for one in additions]
        return np.array([*changed, *added][: action_size(bench.action_space)])

    listed = sorted(additions, key=lambda one: one.name) if name is not str else additions
    return Verb("step", "Take one step; what is left out stays as it is.", (*changes, *listed), action)
