"""The laboratory as plain text, for terminals and logs."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
import numpy.typing as npt

from ..config.parts import blamed
from ..config.scenario import Scenario
from ..kernels.arrays import IntArray, ObservationArray
from ..physics.chemistry import WAVELENGTHS_NM
from ..roles.bench import Bench, Channel, channel_slices
from ..roles.grades import REPORT
from ..roles.manager_state import COST_ITEMS, COST_WORDS, RUNNING, STATUS_WORDS
from ..roles.manager_view import order_channels, shown_share
from .engine import Laboratories

_BAR = 20
_CURVE_ERROR = 0.05
"""Maximum error of a curve in words, by linear interpolation between the printed points."""
_LONG = 16
"""Channels with more values are described as curves."""
_NOISY = 0.05
"""Standard deviation above which a long channel is printed value by value: its curve would have a point at each."""
_BLANK = 2.0
"""Resolution (of full scale) above which a channel always reads 0."""
_PURE = (5, 10, 20, 40)
"""Minimum number of consecutive pixels of a separately listed layer; thinner ones are part of a mixed zone.

The first that lists at most :data:`_MOST_ZONES` zones is used: a stirred vessel has dozens of random ones.
"""
_MOST_ZONES = 6
_COLUMNS = " | "
"""Between the cells of an order and the heads of their columns."""
EVENT_WORDS = {
    "spill_l": ("spilled", " L"),
    "relief_valve_mol": ("relief valve", " mol"),
    "boiled_dry": ("boiled dry", "x"),
    "dry_heating": ("heated dry", "x"),
    "metal_in_water_mol": ("metal in water", " mol"),
}
"""Safety events in words, and the units of their amounts."""
_READING = re.compile(r"(\S+ at tick \S+): (.*)")
_ZEROS = re.compile(r"(\d)(?:(\.\d*[1-9])|\.)0+(?!\d)")
_SHARES = re.compile(r"(\S+ [\d.]+%(, |$))+")


def event_words(kind: str, amount: float) -> tuple[str, str]:
    """Return a safety event in words, and its amount with its unit."""
    words, unit = EVENT_WORDS.get(kind, (kind.replace("_", " "), ""))
    return words, f"{amount:.3g}{unit}"


def named_events(scenario: Scenario, info: Mapping[str, Any]) -> dict[str, float]:
    """The safety events of an agent's info by kind, without those of amount 0."""
    amounts = info["events"].tolist()
    return {kind: amount for kind, amount in zip(scenario.safety_events, amounts, strict=True) if amount}


def named_costs(info: Mapping[str, Any]) -> dict[str, float]:
    """Return the costs of the manager's info by item, in units of the score."""
    return dict(zip(COST_ITEMS, info["costs"].tolist(), strict=True))


def action_words(laboratories: Laboratories, agent: int, action: Any) -> str:
    """An action in words; of a continuous one, its changes.

    Args:
        laboratories: the laboratories.
        agent: index of the agent whose action it is.
        action: an int, or the numbers of a continuous action.
    """
    return laboratories.roles[agent].workplace.action_words(action)


def reading_words(laboratories: Laboratories, slot: int, instrument: str) -> str:
    """Describe the manager's last reading of an instrument on a slot, with its price."""
    labs, table = laboratories, laboratories.instruments
    i = table.names.index(instrument)
    values = labs.state.reading[0, slot, table.start[i] : table.start[i + 1]]
    return f"{measured_words(labs, i, values)}; price {table.price[i]:g}"


def measured_words(
    laboratories: Laboratories, instrument: int, values: Any, name: Callable[[str], str] | None = None
) -> str:
    """Describe a reading.

    Args:
        laboratories: the laboratories that own the instruments.
        instrument: index of the instrument.
        values: the reading, in [0, 1].
        name: replaces the names of materials; default: their own.
    """
    table = laboratories.instruments
    channel = table.channels[instrument]
    spec = laboratories.scenario.instruments[table.names[instrument]]
    noise, values = spec.noise, np.asarray(values)
    low, span = (channel.low, channel.high - channel.low) if channel.size == 1 else (0.0, 1.0)
    exact = (_as_exact_as(noise * span, low + values.astype(np.float64) * span) - low) / span
    least = 0.5 * 10.0 ** math.floor(math.log10(noise)) if noise > 0.0 else 0.0
    values = np.where(np.abs(values) <= least, 0.0, exact)  # of nothing, an instrument reads next to nothing
    if channel.unit == "grey":
        return Shades(laboratories.scenario).words(values, name)
    if channel.size > _LONG:
        return curve_words(channel, values)
    analytes = table.analytes[instrument]
    named = f"{laboratories.scenario.origin}: instruments.{table.names[instrument]}: {spec.kind}: words()"
    with blamed(named):
        words = table.kinds[instrument].words(values, channel, [name(one) for one in analytes] if name else analytes)
        # A reading with noise has fewer digits than the words of its instrument: the rest are zeros.
        return _ZEROS.sub(r"\1\2", words) if noise > 0.0 else words.replace(".0%", "%")


def _as_exact_as(noise: float, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Round values to the largest power of ten within half of their noise, a standard deviation on the same scale."""
    return np.round(values, math.ceil(-math.log10(0.5 * noise))) if noise > 0.0 else np.asarray(values)


def position_words(bench: Bench) -> str:
    """Describe the vessels at a bench."""
    first, *others = bench.positions
    clean = f"; {', '.join(others)}: empty, {bench.auxiliary_capacity_l:g} L" if others else ""
    return f"{first}: brought to the bench{clean}"


def noisy_channels(bench: Bench) -> list[str]:
    """Return the names of long channels of which single values tell next to nothing."""
    long = [channel.name for channel in bench.channels if channel.size > _LONG]
    return [name for name in long if bench.spec.noise.get(name, 0.0) > _NOISY]


def blank_channels(bench: Bench) -> list[str]:
    """Return the names of channels with a resolution so coarse that they always read 0."""
    return [name for name, resolution in bench.spec.resolution.items() if resolution > _BLANK]


# -- pictures and curves ----------------------------------------------------------------------------------------------


def curve_words(channel: Channel, values: npt.NDArray[Any]) -> str:
    """Describe a curve by the points ``x:percent`` of a piecewise linear approximation with an error of at most
    0.05.
    """
    found = np.asarray(values, dtype=np.float64)
    spectrum = channel.unit == "absorption" and len(found) == len(WAVELENGTHS_NM)
    x = WAVELENGTHS_NM if spectrum else np.arange(len(found))
    points = " ".join(f"{x[i]:.0f}:{100.0 * found[i]:.0f}" for i in _vertices(found))
    return f"{'nm:%' if spectrum else 'index:%'} {points}"


def _vertices(values: npt.NDArray[np.float64]) -> list[int]:
    """Return the indices of the points of the approximation (Ramer, Douglas and Peucker's algorithm)."""
    kept, open_spans = {0, len(values) - 1}, [(0, len(values) - 1)]
    while open_spans:
        first, last = open_spans.pop()
        if last - first < 2:
            continue
        inside = np.arange(first + 1, last)
        error = np.abs(values[inside] - np.interp(inside, [first, last], values[[first, last]]))
        if error.max() > _CURVE_ERROR:
            worst = int(inside[error.argmax()])
            kept.add(worst)
            open_spans += [(first, worst), (worst, last)]
    return sorted(kept)


class Shades:
    """Materials by grey value in a layer camera.

    Attributes:
        names: names of the materials, air first.
    """

    def __init__(self, scenario: Scenario) -> None:
        visible = {name: m for name, m in scenario.materials.items() if m.role not in ("gas", "ion")}
        shown = {"air": scenario.materials["air"], **visible}
        self.names = list(shown)
        self.colors = [material.color for material in shown.values()]
        self._values = np.array([material.shade for material in shown.values()])

    def materials(self, pixels: npt.NDArray[Any]) -> IntArray:
        """Return [pixels] the index of the material with the nearest grey value."""
        return np.asarray(np.abs(np.asarray(pixels)[:, None] - self._values).argmin(axis=1), dtype=np.int64)

    def words(self, pixels: npt.NDArray[Any], name: Callable[[str], str] | None = None) -> str:
        """Describe a camera picture as heights of layers in percent from the bottom; air at the top is omitted."""
        kinds = self.materials(pixels).tolist()
        while kinds and kinds[-1] == 0:
            kinds.pop()
        zones: list[list[int]] = []
        for least in _PURE:
            zones = self._zones(kinds, least)
            if len(zones) <= _MOST_ZONES:
                break
        words, at, full = [], 0, len(pixels)
        for zone in zones:
            places = f"{100 * at / full:.0f}-{100 * (at + len(zone)) / full:.0f}"
            at += len(zone)
            shares = {self.names[kind]: zone.count(kind) for kind in sorted(set(zone))}
            called = [name(one) if name and one != "air" else one for one in shares]
            if len(shares) == 1:
                words.append(f"{called[0]} {places}")
            else:
                parts = zip(called, shares.values(), strict=True)
                mixed = "/".join(f"{one} {100 * count / full:.0f}" for one, count in parts)
                words.append(f"mixed {places} ({mixed})")
        return ", ".join(words) or "empty"

    @staticmethod
    def _zones(kinds: Sequence[int], least: int) -> list[list[int]]:
        """Divide pixels into layers of at least ``least`` pixels and mixed zones between them."""
        zones: list[list[int]] = []
        for _, group in groupby(kinds):
            run = list(group)
            if len(run) < least and zones and not (len(zones[-1]) >= least and len(set(zones[-1])) == 1):
                zones[-1] += run
            else:
                zones.append(run)
        return zones


# -- observation of a role --------------------------------------------------------------------------------------------


def _number(value: float) -> str:
    return f"{value * (1.0 + 1e-7):.4g}"  # float32, in which 298.15 may be slightly less, rounds as the number itself


def _time(tick: float) -> str:
    return _number(round(tick, 2) + 0.0)  # observations are float32, and 0 has no sign


def _listed(channel: Channel) -> list[str]:
    """Return the names of a channel's values, which its meaning lists after a colon; empty without a list."""
    names = channel.meaning.rpartition(": ")[2].split(", ")
    return names if len(names) == channel.size else []


class RoleText:
    """Text of one role's observation, generated from its declared channels, for people and models alike.

    It also stores the role's own actions (:meth:`acted`): the bench to which each vessel was sent, and filled orders.

    Args:
        laboratories: only the public scenario and the declared channels are used.
        agent: index of the agent.
        name: replaces the names of materials; default: their own.

    Attributes:
        noisy: names of long channels of which single values tell next to nothing.
    """

    def __init__(self, laboratories: Laboratories, agent: int, name: Callable[[str], str] | None = None) -> None:
        self._labs, self._manages = laboratories, agent == laboratories.manager.index
        self._role = laboratories.roles[agent].workplace
        self._slices = channel_slices(self._role.channels)
        bench = self._role if isinstance(self._role, Bench) else None
        reports = {  # to the manager
            f"{bench_agent}_reported_{what}": one.spec.report or 0.0
            for bench_agent, one in zip(laboratories.bench_agents, laboratories.benches, strict=True)
            for what in REPORT[:2]
        }
        self._noise = reports if bench is None else bench.spec.noise
        self.noisy = [] if bench is None else noisy_channels(bench)
        self._shades = Shades(laboratories.scenario)
        self._name = name or str
        self._subjects = self._group()
        self._scales = self._known_scales()
        self.begin()

    def begin(self) -> None:
        """Clear the stored actions at the start of an episode."""
        self._away: dict[str, tuple[str, str]] = {}
        self._filled: set[str] = set()
        self._seen: dict[str, str] = {}

    def acted(self, action: Any) -> None:
        """Store an action of the role that was carried out."""
        if not self._manages:
            return
        kind, *arguments = self._labs.actions.decode(int(action))
        if kind == "start":
            slot = f"slot_{arguments[1]}"
            self._away[slot] = (str(arguments[0]), self._seen.get(slot, ""))
        elif kind == "submit" and len(arguments) > 1:
            self._filled.add(f"goal_{arguments[1]}")

    def _group(self) -> dict[str, list[tuple[str, Channel]]]:
        """Return (label, channel) of every channel, by the slot, bench, order or instrument it refers to; '' if
        none.
        """
        scenario = self._labs.scenario
        known = [f"slot_{s}" for s in range(scenario.shelf.slots)] + self._labs.bench_agents
        known += [order for order, _ in order_channels(scenario)] + list(scenario.instruments)
        subjects: dict[str, list[tuple[str, Channel]]] = {}
        blank = blank_channels(self._role) if isinstance(self._role, Bench) else []
        for channel in [channel for channel in self._role.channels if channel.name not in blank]:
            fitting = [k for k in known if self._manages and (channel.name == k or channel.name.startswith(f"{k}_"))]
            subject = max(fitting, key=len, default="")
            label = channel.name[len(subject) :].strip("_") if subject else channel.name
            subjects.setdefault(subject, []).append((label.replace("_", " "), channel))
        return subjects

    def _known_scales(self) -> dict[str, tuple[list[float], list[str], str]]:
        """Return (factor and name of every value, unit) of channels that are shares of a quantity stated by the
        scenario.
        """
        labs, scenario = self._labs, self._labs.scenario
        limits, scales = scenario.limits, {}
        if self._manages:
            scales["stock"] = ([*scenario.stock.values()], [*map(self._name, scenario.stock)], "mol")
            scales["budget"] = ([limits.budget], [""], "for measuring")
            scales["actions"] = ([float(limits.manager_actions)], [""], "actions")
            scales["ticks"] = ([float(limits.ticks)], [""], "ticks")
            for agent, bench in zip(labs.bench_agents, labs.benches, strict=True):
                scales[f"{agent}_steps_left"] = ([float(bench.step_limit)], [""], "steps left")
        elif isinstance(self._role, Bench):
            full = getattr(self._role.options, "reagents", {})
            scales["reagents"] = ([*full.values()], [*map(self._name, full)], "mol")
            if self._role.grades.names:
                factors = [self._role.grades.largest, 1.0, float(self._role.step_limit)]
                scales["grade"] = (factors, ["mol at least", "purity at least", "ticks allowed"], "")
        named = [
            name if scenario.world.draws[name].variables == 1 else f"{name} {k}"
            for name in scenario.world.told_to(self._role.key)
            for k in range(scenario.world.draws[name].variables)
        ]
        scales["told"] = ([1.0] * len(named), [f"{name} quantile" for name in named], "")
        return scales

    def lines(self, observation: ObservationArray, noisy: bool = True, only: str = "") -> list[tuple[str, str]]:
        """Return the observation as lines: (slot, bench, order or instrument it is about, or empty; words).

        Args:
            observation: of the role.
            noisy: whether noisy channels are included.
            only: a slot (``slot_0``), or ``goal`` for the orders, whose lines alone are returned; default: all.
        """
        found: list[tuple[str, str]] = []
        if self._manages:
            self._tick = self._labs.scenario.limits.ticks * (1.0 - float(observation[self._slices["ticks"]][0]))
        for subject, channels in self._subjects.items():
            if only not in ("", subject, subject.rpartition("_")[0]):
                continue
            values = {channel.name: observation[self._slices[channel.name]] for _, channel in channels}
            if subject:
                parts = self._about(subject, channels, values)
                self._seen[subject] = ", ".join(parts)
            else:
                shown = [pair for pair in channels if noisy or pair[1].name not in self.noisy]
                parts = self._general(shown, values)
            found += [(subject, words) for words in parts]
        return found

    def text(self, observation: ObservationArray) -> str:
        """Return the observation as one text."""
        return "\n".join(folded_lines(self.lines(observation)))

    def _general(self, channels: list[tuple[str, Channel]], values: Mapping[str, npt.NDArray[Any]]) -> list[str]:
        """Return the channels of the role itself, a line each; amounts of several materials have a line each, too."""
        lines, left = [], " left" if self._manages else ""
        for label, channel in channels:
            own = values[channel.name]
            if channel.name in ("stock", "reagents"):
                lines += [f"{one}{left}" for one in self._words(label, channel, own, "").split(", ")]
            elif channel.size > 1 or channel.unit == "one-hot":
                lines.append(f"{label}: {self._words(label, channel, own, '')}")
            else:
                now = f"tick {_time(self._tick)}, " if channel.name == "ticks" else ""
                lines.append(f"{now}{self._words(label, channel, own, label)}{left}")
        return lines

    def _about(
        self, subject: str, channels: list[tuple[str, Channel]], values: Mapping[str, npt.NDArray[Any]]
    ) -> list[str]:
        """Return the observation of a slot, a bench, an order or an instrument, in parts that may be alike."""
        ages = {channel.name for label, channel in channels if label.endswith("age")}
        still = all((value >= 1.0).all() if name in ages else not value.any() for name, value in values.items())
        if subject.startswith("slot_"):
            if not still:
                self._away.pop(subject, None)
                return self._vessel(channels, values)
            if subject in self._away:
                bench, before = self._away[subject]
                return [f"vessel at {bench}" + (f" (before: {before})" if before else "")]
            return ["empty"]
        if subject.startswith("goal"):
            return [self._order(subject, channels, values, still)]
        if not any(values[one.name].any() for label, one in channels if label.startswith("reported")):
            channels = [pair for pair in channels if not pair[0].startswith("reported")]
        words = [self._words(label, channel, values[channel.name], label) for label, channel in channels]
        if subject in self._labs.bench_agents and not values[f"{subject}_busy"].any():
            own = (f"{subject}_busy", f"{subject}_goal", f"{subject}_steps_left")
            if not any(values[name].any() for name in own):
                rest = [w for w, (_, channel) in zip(words, channels, strict=True) if channel.name not in own]
                words = ["idle", *rest]
            for slot in [slot for slot, (bench, _) in self._away.items() if bench == subject]:
                del self._away[slot]
        first, *reports = ", ".join(filter(None, words)).split(", reported ")
        return [", ".join([first, f"reported {reports[0]}", *reports[1:]] if reports else [first])]

    def _order(
        self, subject: str, channels: list[tuple[str, Channel]], values: Mapping[str, npt.NDArray[Any]], still: bool
    ) -> str:
        if still:
            return "filled" if subject in self._filled or len(channels) == 1 else "not arrived yet"
        self._filled.discard(subject)
        cells = {}
        for label, channel in channels:
            own = values[channel.name]
            if label == "ticks left":  # a time that stays, so that only news is repeated
                left = channel.unscaled(float(own[0]))
                due = min(self._tick + left, self._labs.scenario.limits.ticks)
                cells["due at tick"] = _time(due) if left > 0.0 else "now or earlier"
            elif channel.size > 1 or channel.unit == "one-hot":
                cells["goal"] = self._words(label, channel, own, label)
            elif own.any() or not label.endswith("at least"):
                number, _, unit = self._words(label, channel, own, "").partition(" ")
                cells[f"{label} ({unit})" if unit else label] = number
        if len(channels) == 1:
            return cells["goal"]
        return f"{' '.join(cells.values())}{_COLUMNS}{', '.join(cells)}"

    def _vessel(self, channels: list[tuple[str, Channel]], values: Mapping[str, npt.NDArray[Any]]) -> list[str]:
        """Describe a vessel on the shelf: its visible properties, and each of its readings."""
        labels = dict(channels)
        value = {label: float(values[channel.name][0]) for label, channel in labels.items() if channel.size == 1}
        capacity = value["capacity"] * labels["capacity"].high
        warm = labels["temperature"]
        words = [] if value["occupied"] > 0.5 else ["no vessel"]
        words.append(f"{_number(value['fill'] * capacity)}/{_number(capacity)} L")
        words.append(f"{_number(warm.unscaled(value['temperature']))} K")
        bench, position = (self._chosen(labels[f"last {which}"], values) for which in ("bench", "position"))
        origin = f"{bench} {self._position(bench, position)}".strip()
        if origin not in ("", "none"):
            words.append(f"from {origin}")
        instruments = [name.replace("_", " ") for name in self._labs.instruments.names]
        known, readings = {"occupied", "fill", "temperature", "capacity", "last bench", "last position"}, []
        for i, instrument in enumerate(instruments):
            known |= {instrument, f"{instrument} age"}
            reading, age = labels.get(instrument), value[f"{instrument} age"]
            shown = None if reading is None else values[reading.name]
            # The age alone does not distinguish a reading as old as the longest episode from none: both are 1.
            if age >= 1.0 and (shown is None or not shown.any()):
                continue
            when = f"at tick {_time(self._tick - age * labels[f'{instrument} age'].high)}"
            measured = "" if shown is None else f": {measured_words(self._labs, i, shown, self._name)}"
            readings.append(f"{self._labs.instruments.names[i]} {when}{measured}")
        words += [self._words(label, one, values[one.name], label) for label, one in channels if label not in known]
        return [", ".join(words), *readings]

    def _position(self, key: str, position: str) -> str:
        """Return a bench's own name of a position, which the channel encodes as an index."""
        bench = next((bench for bench in self._labs.benches if bench.key == key), None)
        generic = {"main vessel": 0, "B1": 1, "B2": 2}.get(position)
        if bench is None or generic is None or generic >= len(bench.positions):
            return position
        return bench.positions[generic] if len(bench.positions) > 1 else ""

    @staticmethod
    def _chosen(channel: Channel, values: Mapping[str, npt.NDArray[Any]]) -> str:
        """The name that a one-hot channel selects; empty where it selects none."""
        own = values[channel.name]
        names = channel.meaning.rpartition(": ")[2].split(", ")
        return names[int(own.argmax())] if own.any() else ""

    def _words(self, label: str, channel: Channel, values: npt.NDArray[Any], before: str) -> str:
        """Describe the values of one channel; ``before`` is put in front of single numbers."""
        if channel.unit == "one-hot":
            chosen = self._chosen(channel, {channel.name: values})
            own = chosen in self._labs.scenario.materials
            return (self._name(chosen) if own else chosen) or "none"
        if self._manages and label == "calibrated":
            return f"{before} at tick {_time(self._tick - channel.unscaled(float(values[0])))}"
        if self._manages and label == "repair":
            return f"under repair: {_number(channel.unscaled(float(values[0])))} ticks left" if values[0] else ""
        if channel.unit == "0 or 1":
            return before if values[0] > 0.5 else f"not {before}" if label != "broken" else ""
        if channel.name in self.noisy:  # in hundredths
            return "two digits a value " + "".join(f"{min(int(100.0 * value), 99):02d}" for value in values)
        if channel.unit == "grey":
            return self._shades.words(values, self._name)
        if channel.name in self._scales:
            factors, names, unit = self._scales[channel.name]
            amounts = [round(float(v) * f, 6) for v, f in zip(values, factors, strict=True)]
            numbers = [f"{one:.3g}" if unit == "mol" and one < 1000.0 else _number(one) for one in amounts]
            pairs = zip(names, numbers, strict=True)
            return ", ".join(f"{name} {number} {unit}".strip() for name, number in pairs)
        if channel.unit.startswith("share"):
            return f"{before} {100.0 * float(values[0]):.3g}%".strip()
        noise = self._noise.get(channel.name, 0.0) * (channel.high - channel.low)
        exact = _as_exact_as(noise, channel.unscaled(values.astype(np.float64)))
        scaled = [_number(value) for value in exact.tolist()]
        unit = "" if channel.unit in ("fraction", "mole fraction", *label.split()) else f" {channel.unit}"
        if channel.size == 1:
            return f"{before} {scaled[0]}{unit}".strip()
        if channel.size > _LONG:
            return curve_words(channel, values)
        names = _listed(channel)
        materials = self._labs.scenario.materials
        named = [self._name(one) if one in materials else one for one in names] or [str(i) for i in range(channel.size)]
        return ", ".join(f"{one} {number}" for one, number in zip(named, scaled, strict=True)) + unit


def folded_lines(lines: Sequence[tuple[str, str]], known: Collection[tuple[str, str]] = ()) -> list[str]:
    """Return lines as text: slots and benches with equal words share one, as do readings of an instrument, and orders.

    Args:
        lines: of :meth:`RoleText.lines`, or some of them.
        known: those of which curves, and terms of orders, are left out.
    """
    alike: dict[tuple[str, bool], list[str]] = {}
    for subject, words in lines:
        short = (subject, words) in known
        told = "open (look at orders to read them)" if short and _COLUMNS in words else words
        alike.setdefault((told, short), []).append(subject)
    found: dict[str, list[str]] = {}
    for (words, short), subjects in alike.items():
        name, reading, row = _together(subjects), _READING.fullmatch(words), words.partition(_COLUMNS)
        if row[1]:
            found.setdefault(f"orders ({row[2]})", []).append(f"{name.partition(' ')[2]}: {row[0]}")
        elif reading is None or not name.startswith("slot"):
            found.setdefault(f"{name}: {words}" if name else words, [])
        else:
            head, words = reading.groups()
            if _SHARES.fullmatch(words):
                head, words = f"{head} (%)", re.sub("%(,|$)", "", words)
            elif short and words.startswith(("nm:%", "index:%")):
                head, name, words = f"{head} (look at one slot to read it)", name.partition(" ")[2], ""
            found.setdefault(head, []).append(f"{name} {words}".strip())
    marks = {head: "; " if any(" " in item for item in items) else ", " for head, items in found.items()}
    return [f"{head}: {marks[head].join(items)}" if items else head for head, items in found.items()]


def _together(subjects: Sequence[str]) -> str:
    """Return the names of slots, orders and benches that share a line: ``slots 0-3, 5``."""
    kind, _, number = subjects[0].rpartition("_")
    words = {"slot": "slot", "goal": "order"}.get(kind)
    if words is None or not number.isdigit():
        return ", ".join("order" if subject == "goal" else subject for subject in subjects)
    numbers = [int(subject.rpartition("_")[2]) for subject in subjects]
    spans = []
    for _, group in groupby(enumerate(numbers), key=lambda pair: pair[1] - pair[0]):
        run = [n for _, n in group]
        spans.append(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}")
    return f"{words}{'s' if len(numbers) > 1 else ''} {', '.join(spans)}"


def describe_laboratory(labs: Laboratories) -> str:
    """Describe shelf, benches, goal and costs of a single laboratory, as visible to its agents."""
    state, scenario = labs.state, labs.scenario
    status = STATUS_WORDS[int(state.status[0])]
    turn = labs.agents[labs.turn()] if state.status[0] == RUNNING else "nobody"
    known = labs.manager.accounts(0)
    first = known["goals"].item(0)
    lines = [
        f"{scenario.title} - goal {scenario.goals[first] if first >= 0 else 'unknown'} - {status}",
        f"manager actions {state.actions[0]}/{scenario.limits.manager_actions}, "
        f"ticks {state.ticks[0]}/{scenario.limits.ticks}, turn: {turn}",
    ]
    keys, largest = list(scenario.benches), float(labs.rules.arrays.largest_capacity)
    for s in range(scenario.shelf.slots):
        vessel = labs.shelf.vessel(0, s)
        if not vessel.present:
            holder = int(state.reserved[0, s])
            lines.append(f"  slot {s}  {'(kept for ' + labs.bench_agents[holder] + ')' if holder >= 0 else '-'}")
            continue
        fill = shown_share(vessel.volume_l / vessel.capacity_l, scenario.shelf.gauge)
        capacity = vessel.capacity_l
        if scenario.shelf.gauge:
            capacity = shown_share(capacity / largest, scenario.shelf.gauge) * largest
        litres = f"{fill * capacity:.2f}/{capacity:.2f} L"
        bar = "#" * round(fill * _BAR)
        kind = int(state.last_bench[0, s])
        history = ""
        if kind > 0:
            bench = next(bench for bench in labs.benches if bench.key == keys[kind - 1])
            history = f"  from {bench.key} {bench.positions[state.last_position[0, s]]}"
        read = [name for i, name in enumerate(labs.instruments.names) if state.age[0, s, i] >= 0]
        measured = f"  measured: {', '.join(read)}" if read else ""
        lines.append(f"  slot {s}  [{bar:<{_BAR}}] {litres}{history}{measured}")
    for bench, experiments in zip(labs.benches, labs.experiments, strict=True):
        if experiments.busy[0]:
            goal = scenario.goals[experiments.goal[0]]
            doing = f"step {experiments.steps[0]}/{bench.spec.step_limit}, goal {goal}"
        else:
            doing = "idle"
        lines.append(f"  {experiments.agent:<7} {doing}")
    charged = zip(COST_WORDS, known["costs"].tolist(), strict=True)
    costs = ", ".join(f"{item} {value:.4f}" for item, value in charged if value > 0.0)
    lines.append(f"  costs: {costs or 'none'}")
    return "\n".join(lines)
