"""The verbs of a role: its actions as functions of a few named arguments, built from the scenario."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from chemlab.lab.engine import Laboratories
from chemlab.roles.bench import Bench
from chemlab.roles.operation_bench import OperationBench
from chemlab.roles.operations import OPERATIONS

_MOST_TEXT = 60
"""Characters of a given value that an error repeats."""


class ToolError(ValueError):
    """A call that was refused: nothing has changed, and the message says what can be called instead."""


def plain(value: Any, most: int = _MOST_TEXT) -> str:
    """A value from outside as printable text of bounded length."""
    try:
        text = value if isinstance(value, str) else repr(value)
    except Exception:  # the repr of somebody else's object
        text = f"<{type(value).__name__}>"
    text = "".join(mark if mark.isprintable() else " " for mark in text[: most + 1])
    return text if len(text) <= most else text[: most - 3] + "..."


def number_of(value: Any) -> float | None:
    """A finite number given as such or as text; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def amount_of(value: Any) -> str:
    """Describe the length of a text for an error, or the value if it is no text."""
    return f"{len(value)} characters" if isinstance(value, str) else plain(value)


@dataclass(frozen=True)
class Argument:
    """An argument of a verb: one of some options, or a number from ``low`` to ``high``.

    Attributes:
        name: the name.
        meaning: a description for people and models.
        options: the accepted values, strings or integers; empty: any number in the range.
        low: smallest number.
        high: largest number.
        default: the value where none is given; None: it must be given.
        longest: characters of a text; 0: it is no text.
    """

    name: str
    meaning: str
    options: tuple[str | int, ...] = ()
    low: float = 0.0
    high: float = 1.0
    default: str | int | float | None = None
    longest: int = 0

    def checked(self, verb: str, value: Any) -> str | int | float:
        """The accepted value that ``value`` stands for: ``"1"`` for 1, ``10`` for ``"10"``.

        Raises:
            ToolError: there is none.
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
        known = ", ".join(map(str, self.options)) or f"a number from {self.low:g} to {self.high:g}"
        raise ToolError(f"{verb}: {self.name} must be {'one of ' if self.options else ''}{known}; given {plain(value)}")


@dataclass(frozen=True)
class Verb:
    """A verb of a role.

    Attributes:
        name: as it is called.
        meaning: one sentence.
        arguments: in order.
        action: the action that checked arguments stand for; it raises :class:`ToolError` where there is none. None: the
            verb is no action of the laboratory.
        settled: arguments of one possible value, which need not be given.
    """

    name: str
    meaning: str
    arguments: tuple[Argument, ...] = ()
    action: Callable[[Mapping[str, Any]], Any] | None = None
    settled: tuple[Argument, ...] = ()

    @property
    def takes(self) -> str:
        """Number and names of its arguments, as the end of a sentence."""
        names = [argument.name for argument in self.arguments]
        if not names:
            return "takes no arguments"
        return f"takes {len(names)} argument{'' if len(names) == 1 else 's'} ({', '.join(names)})"

    def checked(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """All arguments, checked, with defaults.

        Raises:
            ToolError: one is unknown, missing or wrong.
        """
        names = [argument.name for argument in self.arguments]
        takes = f"takes {', '.join(names)}" if names else "takes no arguments"
        for argument in self.settled:
            if argument.name in given:
                argument.checked(self.name, given[argument.name])
        given = {key: value for key, value in given.items() if key not in [one.name for one in self.settled]}
        unknown = [plain(key) for key in given if key not in names]
        if unknown:
            raise ToolError(f"{self.name}: unknown argument {unknown[0]}; it {takes}")
        found = {}
        for argument in self.arguments:
            if argument.name in given:
                found[argument.name] = argument.checked(self.name, given[argument.name])
            elif argument.default is not None:
                found[argument.name] = argument.default
            else:
                raise ToolError(f"{self.name}: {argument.name} is missing; it {takes}")
        return found


def _several(arguments: Iterable[Argument]) -> tuple[Argument, ...]:
    """The arguments that leave a choice."""
    return tuple(argument for argument in arguments if len(argument.options) != 1)


def _settled(arguments: Iterable[Argument]) -> tuple[Argument, ...]:
    """The arguments of one possible value."""
    return tuple(argument for argument in arguments if len(argument.options) == 1)


# -- the manager ------------------------------------------------------------------------------------------------------

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


def manager_verbs(labs: Laboratories, name: Callable[[str], str]) -> list[Verb]:
    """The manager's verbs; ``name`` gives the names that materials have in them."""
    actions, scenario = labs.actions, labs.scenario
    own = {name(goal): goal for goal in scenario.goals}
    goals = tuple(sorted(own) if name is not str else own)
    bench = Argument("bench", "the bench", tuple(actions.bench_agents))
    slot = Argument("slot", "the slot of the shelf", tuple(range(actions.slots)))
    arguments = {
        "start": (
            bench,
            slot,
            Argument("goal", "the material that the experiment is for", goals),
            *([Argument("grade", "the quality that is asked for", actions.grades)] if actions.grades else []),
        ),
        "measure": (slot, Argument("instrument", "the instrument", actions.instruments)),
        "discard": (slot,),
        "submit": (
            slot,
            *([Argument("order", "the order", tuple(range(actions.orders)))] if actions.orders > 1 else ()),
        ),
        "recall": (bench,),
        "wait": (),
        "calibrate": (Argument("instrument", "the instrument", actions.drifting),),
        "repair": (Argument("bench", "the bench", actions.wearing),),
    }
    kinds = {str(actions.decode(action)[0]) for action in range(len(actions))}

    def encoder(kind: str) -> Callable[[Mapping[str, Any]], int]:
        def encode(given: Mapping[str, Any]) -> int:
            values = [given.get(a.name, a.options[0]) for a in arguments[kind]]
            return actions.encode(kind, *(own.get(v, v) for v in values))

        return encode

    return [
        Verb(kind, meaning, _several(arguments[kind]), encoder(kind), _settled(arguments[kind]))
        for kind, meaning in _MANAGER.items()
        if kind in kinds
    ]


# -- benches ----------------------------------------------------------------------------------------------------------

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
    """The verbs of a bench's agent; ``name`` gives the names that materials have in them."""
    if isinstance(bench, OperationBench):
        return _operation_verbs(bench, name)
    if bench.action_count:
        meanings = [_renamed(bench, words, name) for words in bench.action_meanings]
        choice = Argument("action", "what to do", tuple(dict.fromkeys(meanings)))
        return [Verb("choose", "Take one step.", (choice,), lambda given: meanings.index(given["action"]))]
    return [_continuous_verb(bench, name)]


def _renamed(bench: Bench, words: str, name: Callable[[str], str]) -> str:
    if name is str:
        return words
    known = sorted(bench.scenario.materials, key=len, reverse=True)
    pattern = "|".join(rf"(?<![\w-]){re.escape(one)}(?![\w-])" for one in known)
    return re.sub(pattern, lambda match: name(match[0]), words)


def _operation_verbs(bench: OperationBench, name: Callable[[str], str]) -> list[Verb]:
    rows: dict[str, dict[tuple[Any, ...], int]] = {}
    units: dict[str, str] = {}
    actions = [(process, magnitude) for process in bench.options.process for magnitude in process.magnitudes]
    for at, ((process, magnitude), words) in enumerate(zip(actions, bench.action_meanings, strict=False)):
        kind = process.kind.rpartition(":")[2].lower()
        material = process.material and name(process.material)
        rows.setdefault(kind, {})[process.vessel, process.target, material, f"{magnitude:g}"] = at
        units[kind] = OPERATIONS[kind].unit if kind in OPERATIONS else words.rpartition(" ")[2]
    verbs = [_operation_verb(kind, own, units[kind]) for kind, own in rows.items()]
    return [*verbs, Verb("end", "End the experiment.", (), lambda given: bench.end_action)]


def _operation_verb(kind: str, own: Mapping[tuple[Any, ...], int], unit: str) -> Verb:
    parts = ("vessel", "target", "material", "amount")
    meanings = ("the vessel", "the vessel that receives", "the material", f"how much ({unit})")
    arguments = []
    for k, (part, meaning) in enumerate(zip(parts, meanings, strict=True)):
        values = list(dict.fromkeys(key[k] for key in own if key[k] is not None))
        integers = part == "amount" and all(float(value).is_integer() for value in values)
        arguments.append(Argument(part, meaning, tuple(int(value) if integers else value for value in values)))

    def action(given: Mapping[str, Any]) -> int:
        chosen = tuple(
            str(given[a.name]) if a.name in given else (str(a.options[0]) if a.options else None) for a in arguments
        )
        if chosen not in own:
            ways = dict.fromkeys(tuple(str(v) for v in key[:3] if v is not None) for key in own)
            raise ToolError(f"{kind}: these do not go together; possible: {'; '.join(' '.join(way) for way in ways)}")
        return own[chosen]

    return Verb(
        kind,
        _OPERATIONS.get(kind, f"{kind.capitalize()}."),
        tuple(a for a in arguments if len(a.options) > 1),
        action,
        _settled(arguments),
    )


def _continuous_verb(bench: Bench, name: Callable[[str], str]) -> Verb:
    """All numbers of a continuous action in their own units; what is left out stays as it is."""
    reagents: Sequence[str] = getattr(bench, "reagent_names", ())
    size = int((bench.action_space.shape or (0,))[0])
    if not reagents:
        numbers = [Argument(f"number_{i}", words, default=0.5) for i, words in enumerate(bench.action_meanings)]
        return Verb("step", "Take one step.", tuple(numbers), lambda given: np.array([given[n.name] for n in numbers]))
    steps = [bench.options.temperature_k.step, bench.options.volume_l.step]
    moves = [
        Argument("temperature_change", f"K, from {-steps[0]:g} to {steps[0]:g}", (), -steps[0], steps[0], 0.0),
        Argument("volume_change", f"L, from {-steps[1]:g} to {steps[1]:g}", (), -steps[1], steps[1], 0.0),
    ]
    adding = [
        Argument("add_" + re.sub(r"\W", "_", name(one)), f"share of the {name(one)} that is left, 0 to 1", default=0.0)
        for one in reagents
    ]

    def action(given: Mapping[str, Any]) -> Any:
        moved = [0.5 + 0.5 * float(given[move.name]) / step for move, step in zip(moves, steps, strict=True)]
        return np.array([*moved, *(float(given[one.name]) for one in adding)][:size])

    listed = sorted(adding, key=lambda one: one.name) if name is not str else adding
    return Verb("step", "Take one step; what is left out stays as it is.", (*moves, *listed), action)
