"""Human players as policies: observations are shown in words and bars, and actions are typed.

A person has the observation of a learned policy, the public scenario, and, as the manager, the costs so far.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table
from rich.text import Text

from chemlab.config.scenario import Scenario
from chemlab.envs.players import Actions
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.lab.text import RoleText, Shades, action_words, folded_lines, position_words
from chemlab.roles.bench import Bench, channel_slices

from .roles import action_size

_FLAT = 12
"""Maximum number of actions that are listed individually; more are grouped."""
_BLOCKS, _PLAIN = " ▁▂▃▄▅▆▇█", " .:-=+*#@"
"""Signs of a sparkline in Unicode and in ASCII, from 0 to 1."""


class Left(Exception):
    """Raised when the person leaves the game."""


def sparkline(values: Sequence[float] | npt.NDArray[Any], width: int, signs: str = _BLOCKS) -> str:
    """Format numbers in [0, 1] as a line of at most ``width`` signs, from the first sign for 0 to the last for 1.

    A sign shows the maximum of its numbers, so that peaks remain visible.
    """
    parts = np.array_split(np.asarray(values, dtype=np.float64), min(width, len(values)))
    return "".join(signs[round(float(part.max().clip(0.0, 1.0)) * (len(signs) - 1))] for part in parts)


def _grid(rows: Sequence[tuple[str, str | Text]]) -> Table:
    """Return a table of labels and contents; the continuation of a long line is indented."""
    grid = Table.grid(padding=(0, 1))
    grid.add_column(no_wrap=True)
    grid.add_column(overflow="fold")
    for label, content in rows:
        grid.add_row(Text(f"  {label}"), Text(content) if isinstance(content, str) else content)
    return grid


class LetterShades(Shades):
    """Formats camera pictures as coloured letters, one letter per material."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self.letters = ["."]
        for name in self.names[1:]:
            options = [c for c in name.lower() + name.upper() + "abcdefghijklmnopqrstuvwxyz0123456789" if c.isalnum()]
            options = [c for c in options if c.isalpha()] + options
            self.letters.append(next(c for c in options if c not in self.letters))

    def line(self, pixels: npt.NDArray[Any], width: int) -> Text:
        """Return a camera picture as a line, the bottom at the left; a cell shows the majority of its pixels."""
        text = Text()
        for part in np.array_split(self.materials(pixels), min(width, len(pixels))):
            kind = int(np.bincount(part).argmax())
            color = self.colors[kind]
            is_light = sum(int(color[i : i + 2], 16) * w for i, w in ((1, 0.3), (3, 0.6), (5, 0.1))) > 110.0
            text.append(self.letters[kind], style="" if kind == 0 else f"{'black' if is_light else 'white'} on {color}")
        return text

    def legend(self, *pictures: npt.NDArray[Any]) -> str:
        """Return the letters in some pictures with their materials."""
        kinds = sorted({int(kind) for pixels in pictures for kind in self.materials(pixels)})
        return ", ".join(f"{self.letters[kind]} {self.names[kind]}" for kind in kinds)


class Menu:
    """Numbered legal actions; many actions are shown in groups, which typing narrows.

    Args:
        meanings: description of every action.
        paths: description of every action in steps (``start rxn_0``, ``slot 0``, ``goal dodecane``), for grouping.
        legal: indices of the legal actions.
    """

    def __init__(self, meanings: Sequence[str], paths: Sequence[Sequence[str]], legal: Sequence[int]) -> None:
        self._meanings, self._paths = meanings, paths
        self._legal = list(legal)
        self.back()

    def entries(self) -> list[tuple[str, list[int]]]:
        """Return (label, actions) of each numbered line."""
        if len(self._shown) <= _FLAT:
            return [(self._meanings[action], [action]) for action in self._shown]
        groups: dict[str, list[int]] = {}
        for action in self._shown:
            groups.setdefault(self._paths[action][self._depth], []).append(action)
        return [(self._label(part, actions), actions) for part, actions in groups.items()]

    def _label(self, part: str, actions: list[int]) -> str:
        if len(actions) == 1:
            return self._meanings[actions[0]]
        later = dict.fromkeys(step for action in actions for step in self._paths[action][self._depth + 1 :][:1])
        return f"{part}: {_joined(list(later))}"

    def back(self) -> None:
        """Show all actions again."""
        self._shown, self._depth = self._legal, 0

    def _narrow(self, actions: list[int]) -> None:
        """Show only these actions, grouped by the first step in which they differ."""
        self._shown, self._depth = actions, 0
        if len(actions) > _FLAT:
            while len({self._paths[action][self._depth] for action in actions}) == 1:
                self._depth += 1

    def take(self, typed: str) -> int | None:
        """Return the typed action, or None if the menu was narrowed instead.

        Args:
            typed: numbers of lines, one for each level of groups; or the beginning of a description, or words of it.

        Raises:
            ValueError: the line or action does not exist.
        """
        if all(part.isdecimal() for part in typed.split()):
            return self._take_numbers([int(part) for part in typed.split()])
        begins, contains = _matchers(typed)
        starting = [action for action in self._legal if begins(self._meanings[action])]
        exact = [action for action in starting if len(self._meanings[action]) == len(" ".join(typed.split()))]
        if len(exact or starting) == 1:
            return (exact or starting)[0]
        matching = starting or [action for action in self._legal if contains(self._meanings[action])]
        if matching:
            self._narrow(matching)
            return None
        if any(begins(meaning) or contains(meaning) for meaning in self._meanings):
            raise ValueError(f"{typed!r} is not possible now")
        raise ValueError(f"no action is called {typed!r}; type a number of the list, or ? for help")

    def _take_numbers(self, numbers: list[int]) -> int | None:
        for i, number in enumerate(numbers):
            entries = self.entries()
            if not 1 <= number <= len(entries):
                raise ValueError(f"the list goes from 1 to {len(entries)}, given {number}")
            actions = entries[number - 1][1]
            if len(actions) == 1:
                if i < len(numbers) - 1:
                    raise ValueError(f"{number} is an action, not a group; leave out {numbers[i + 1]}")
                return actions[0]
            self._narrow(actions)
        return None


def _matchers(typed: str) -> tuple[Callable[[str], bool], Callable[[str], bool]]:
    """Return two tests of a description: True if it begins with the typed text; True if it contains all its words.

    Words may be abbreviated, but not numbers, and a number belongs to the word before it: ``slot 1`` matches neither
    slot 10 nor ``rxn_1``.
    """

    def pattern(words: str) -> str:
        before = r"(?<![\d.])" if words[0].isdigit() else ""
        after = r"(?!\.?\d)" if words[-1].isdigit() else ""
        return before + "[ _]".join(map(re.escape, words.split())) + after

    phrases = [re.compile(pattern(phrase), re.IGNORECASE) for phrase in re.findall(r"\S+(?:\s+[\d.]+(?=\s|$))*", typed)]
    beginning = re.compile(pattern(typed.strip()), re.IGNORECASE)
    return (
        lambda meaning: beginning.match(meaning) is not None,
        lambda meaning: all(phrase.search(meaning) for phrase in phrases),
    )


def _joined(steps: Sequence[str]) -> str:
    """Join choices, and state their common word once: ``1 / 3 / 8 L``, ``slot 0 / 1``."""
    heads, tails = zip(*(step.partition(" ")[::2] for step in steps), strict=True)
    if len(set(tails)) == 1:
        return f"{' / '.join(heads)} {tails[0]}".strip()
    if len(set(heads)) == 1:
        return f"{heads[0]} {' / '.join(tails)}"
    return " / ".join(steps)


_MOVE = re.compile(
    r"(?P<knob>[tv])(?:(?P<sign>[+-])(?P<part>\d*\.?\d*%?)|=(?P<raw>\d*\.?\d+)|(?P<hold>0))", re.IGNORECASE
)


def _share(text: str, what: str) -> float:
    """Parse a number from 0 to 1, or a percentage; errors name ``what``."""
    try:
        value = float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    except ValueError:
        raise ValueError(f"{what}: {text!r} is not a number") from None
    if not (math.isfinite(value) and 0.0 <= value <= 1.0):
        raise ValueError(f"{what}: must be from 0 to 1 (or 0% to 100%), given {text}")
    return value


def parse_numbers(typed: str, size: int, reagents: Sequence[str] = ()) -> FloatArray:
    """Parse typed text as a continuous action of ``size`` numbers in [0, 1].

    The text has all numbers, or, on a bench with reagents, only changes: ``T+`` (a whole step up), ``T-0.5`` (half a
    step down), ``T=0.7`` (the number itself), ``T0`` (no change), the same with ``V``, and ``NAME=SHARE`` (``NAME``
    alone adds all that is left of the reagent). Names may be abbreviated if they remain unique. Otherwise temperature
    and volume do not change, and nothing is added.

    Raises:
        ValueError: a part cannot be parsed; the message states the accepted ones.
    """
    parts = typed.replace(",", " ").split()
    if not reagents or all(re.fullmatch(r"[\d.]+%?", part) for part in parts):
        if len(parts) != size:
            raise ValueError(f"needs {size} numbers from 0 to 1, given {len(parts)}; ? explains")
        return np.array([_share(part, f"number {i}") for i, part in enumerate(parts, start=1)])
    action = np.zeros(size)
    action[:2] = 0.5
    for part in parts:
        move = _MOVE.fullmatch(part)
        if move is not None:
            knob = "tv".index(move["knob"].lower())
            if move["raw"]:
                action[knob] = _share(move["raw"], move["knob"].upper())
            elif move["sign"]:
                by = 0.5 * (_share(move["part"], move["knob"].upper()) if move["part"] else 1.0)
                action[knob] = 0.5 + by if move["sign"] == "+" else 0.5 - by
            else:
                action[knob] = 0.5
            continue
        name, equals, share = part.partition("=")
        fitting = [r for r in reagents if r.lower() == name.lower()]
        fitting = fitting or [r for r in reagents if r.lower().startswith(name.lower())]
        if len(fitting) != 1 or not name:
            known = f"T, V, {', '.join(reagents)}"
            problem = f"could be {' or '.join(fitting)}" if fitting and name else f"unknown; choose from {known}"
            raise ValueError(f"{part!r}: {problem}; for example: T+ {reagents[0]}=1")
        action[2 + reagents.index(fitting[0])] = _share(share, fitting[0]) if equals else 1.0
    return action


class HumanPolicy:
    """Policy of a person for one agent of one laboratory.

    Args:
        laboratories: the laboratory; only public information is shown.
        number: agent index.
        ask: prompt function that returns the typed text, and raises ``EOFError`` at the end of input.
        console: output console; its width and encoding are respected.
        before: called at the beginning of each of the person's turns.
    """

    def __init__(
        self,
        laboratories: Laboratories,
        number: int,
        ask: Callable[[str], str],
        console: Console | None = None,
        before: Callable[[], None] | None = None,
    ) -> None:
        self._labs, self._number = laboratories, number
        self._is_manager = number == laboratories.manager.index
        self._ask, self._console, self._before = ask, console or Console(), before
        self._role = laboratories.roles[number].workplace
        self._slices = channel_slices(self._role.channels)
        self._shades = LetterShades(laboratories.scenario)
        self._text = RoleText(laboratories, number)
        self._last: npt.NDArray[Any] | None = None
        unicode = (self._console.encoding or "ascii").lower().replace("-", "").startswith("utf")
        self._signs = _BLOCKS if unicode else _PLAIN

    @property
    def agent(self) -> str:
        """Name of the agent."""
        return self._labs.agents[self._number]

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`~chemlab.envs.players.Policy`.

        Raises:
            Left: the person has left.
            ValueError: more than one laboratory; people play one at a time.
        """
        if len(observation) != 1:
            raise ValueError(f"{self.agent}: human players support one laboratory at a time, given {len(observation)}")
        if step[0] == 0:
            self._last = None
            self._text.begin()
        if self._before is not None:
            self._before()
        for part in self.view(observation[0], int(step[0])):
            self._console.print(part)
        self._last = np.asarray(self._numbers() if mask is None else np.int64(self._choose(mask[0])))
        self._text.acted(self._last)
        return self._last[None]

    def view(self, observation: ObservationArray, step: int) -> Iterator[Any]:
        """Yield the observation as printable objects of rich: text (:class:`~chemlab.lab.text.RoleText`) and pictures.

        Args:
            observation: [size] observation of the agent.
            step: number of its earlier turns in the experiment (the manager: in the episode).
        """
        yield ""
        if isinstance(self._role, Bench):
            yield Text.assemble(
                (self.agent, "bold"),
                f": step {step + 1} of {self._role.spec.step_limit}; reward: {self._role.score_meaning}",
            )
        else:
            costs = [f"{item} {value:.4f}" for item, value in self._labs.costs().items() if value > 0.0]
            yield Text.assemble((self.agent, "bold"), f": costs so far: {', '.join(costs) or 'none'}")
        yield _grid([("", line) for line in folded_lines(self._text.lines(observation))])
        yield from self._pictures(observation)

    def _pictures(self, observation: ObservationArray) -> Iterator[Any]:
        """Yield camera pictures as letters and spectra as blocks, if there are any."""
        rows: list[tuple[str, str | Text]] = []
        layers, width = [], max(min(self._console.width - 16, 60), 10)
        for channel in self._role.channels:
            values, label = observation[self._slices[channel.name]], channel.name.removeprefix("layers_")
            if channel.unit == "grey" and values.any():
                layers.append(values)
                rows.append((label, self._shades.line(values, width)))
            elif channel.unit == "absorption" and values.any():
                rows.append((label, sparkline(values, width, self._signs)))
        if layers:
            rows.append(("", f"(bottom at the left; {self._shades.legend(*layers)})"))
        if rows:
            yield _grid(rows)

    def _typed(self) -> str:
        """Return the next typed text that is not a command; raise :class:`Left` at the end of the game or the input."""
        while True:
            try:
                text = self._ask(f"{self.agent}> ").strip()
            except EOFError:
                raise Left("end of input") from None
            if text.lower() in ("q", "quit", "exit"):
                raise Left("you have left")
            if text.lower() not in ("?", "h", "help"):
                return text
            self._console.print(_grid([("", line) for line in self.help()]))

    def _choose(self, mask: npt.NDArray[np.int8]) -> int:
        """Ask for a legal discrete action."""
        labs, meanings = self._labs, list(self._role.action_meanings)
        # A bench's action is a process and a magnitude.
        paths = _manager_paths(labs) if self._is_manager else [meaning.split(", ", 1) for meaning in meanings]
        menu = Menu(meanings, paths, np.flatnonzero(mask).tolist())
        repeat = int(self._last) if not self._is_manager and self._last is not None and mask[int(self._last)] else None
        show_menu = True
        while True:
            if show_menu:
                lines = enumerate(menu.entries(), start=1)
                self._console.print(_grid([(f"{i:>2}", label) for i, (label, _) in lines]))
                if repeat is not None:
                    self._console.print(Text(f"  Enter repeats: {meanings[repeat]}", style="dim"))
            show_menu = True
            text = self._typed()
            try:
                if text.lower() in ("b", "back"):
                    menu.back()
                    continue
                if not text and repeat is None:
                    raise ValueError("type a number of the list, or ? for help")
                action = menu.take(text) if text else repeat
                if action is not None:
                    return action
            except ValueError as error:
                self._console.print(Text(f"  {error}", style="yellow"))
                show_menu = False

    def _numbers(self) -> FloatArray:
        """Ask for a continuous action."""
        size = action_size(self._labs.action_space(self._number))
        reagents = getattr(self._role, "reagent_names", ())
        last = self._last
        if last is None and reagents:
            last = parse_numbers("T0", size, reagents)
        if last is not None:
            words = action_words(self._labs, self._number, last)
            self._console.print(Text(f"  Enter repeats: {words}", style="dim"))
        while True:
            text = self._typed()
            try:
                if text:
                    return parse_numbers(text, size, reagents)
                if last is None:
                    raise ValueError(f"type {size} numbers from 0 to 1, or ? for help")
                return np.asarray(last)
            except ValueError as error:
                self._console.print(Text(f"  {error}", style="yellow"))

    def help(self) -> list[str]:
        """Return instructions for the role, in lines."""
        scenario = self._labs.scenario
        lines = [f"{scenario.title}: {scenario.summary}"]
        reagents = getattr(self._role, "reagent_names", ())
        if self._is_manager:
            maxima = scenario.theoretical_maximum_mol
            goals = [f"{goal} ({maxima[goal]:g} mol at most)" for goal in scenario.lab_goals if goal in maxima]
            prices = [f"{name} {spec.price:g}" for name, spec in scenario.instruments.items()]
            lines += [
                f"Submit a vessel with much and pure product: {', '.join(goals or scenario.lab_goals)}.",
                f"Prices of measurements: {', '.join(prices) or 'there are no instruments'}.",
                "start puts a vessel on a bench; wait lets the benches work until one has finished.",
            ]
        elif isinstance(self._role, Bench):
            gauges = [c for c in self._role.channels if c.size == 1 and c.unit not in ("fraction", "one-hot", "0 or 1")]
            lines += [
                f"When the experiment ends, you are paid {self._role.score_meaning}.",
                f"Vessels: {position_words(self._role)}.",
                *(f"{c.name}: {c.low:g} to {c.high:g} {c.unit}, {c.meaning}" for c in gauges),
            ]
        if self._labs.action_counts[self._number]:
            lines += [
                "Type the number of a line, or several numbers for a line in a group (1 3),",
                "or the beginning of a description; any words narrow the list (slot 0), and b shows all of it again.",
            ]
        elif reagents:
            lines += [f"- {meaning}" for meaning in self._role.action_meanings]
            lines += [
                f"Type changes: T+ V- {reagents[0]}=0.5 (T+0.5 is half a step, T=0.7 the number itself),",
                f"or all {2 + len(reagents)} numbers. Without a change, T and V stay the same; nothing is added.",
                "The experiment ends after the last step.",
            ]
        else:
            lines += [f"  {meaning}" for meaning in self._role.action_meanings]
        return [*lines, "q leaves the game; the record so far is kept."]


def _manager_paths(labs: Laboratories) -> list[list[str]]:
    """Return the manager's actions in steps: kind and bench, slot, goal or instrument, and what else they name."""
    actions, prices = labs.actions, dict(zip(labs.instruments.names, labs.instruments.price.tolist(), strict=True))
    paths, arguments = [], actions.arguments
    for action, words in enumerate(actions.action_meanings):
        kind, *values = actions.decode(action)
        named = dict(zip(arguments[str(kind)], values, strict=True))
        if "slot" not in named:
            paths.append([words])
            continue
        first = f"{kind} {named.pop('bench')}" if "bench" in named else str(kind)
        steps = [
            f"{value} (price {prices[str(value)]:g})" if name == "instrument" else f"{name} {value}"
            for name, value in named.items()
        ]
        paths.append([first, *steps])
    return paths
