"""Tables that describe a laboratory: observations, actions, prices, limits, rewards.

They are made from the channels and action tables that build the spaces, and from the scenario. The documentation and
``chemlab describe`` show the same tables. Names are in `backticks`, as in Markdown.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any

import gymnasium

from ..config.draws import ORDER_QUANTITIES
from ..config.scenario import DemandSpec, InstrumentSpec, ProductSpec, Scenario
from ..roles.base import Workplace
from ..roles.bench import Bench
from .engine import Laboratories
from .text import blank_channels


@dataclass(frozen=True)
class FactTable:
    """A table: column heads, rows of cells, the columns that hold numbers, and an introductory sentence."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    right: tuple[int, ...] = ()
    note: str = ""


def _facts(head: Sequence[str], rows: Iterable[Sequence[Any]], right: Sequence[int] = (), note: str = "") -> FactTable:
    return FactTable(tuple(head), tuple(tuple(str(cell) for cell in row) for row in rows), tuple(right), note)


def code(text: object) -> str:
    return f"`{text}`"


def codes(texts: Iterable[object]) -> str:
    return ", ".join(map(code, texts))


def _number(value: float) -> str:
    """Format a number without an exponent."""
    return f"{value:.10f}".rstrip("0").rstrip(".")


def _span(start: int, size: int) -> str:
    return str(start) if size == 1 else f"{start} to {start + size - 1}"


def _alike(name: str, rows: Iterable[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return rows of numbered things, with equal ones that follow each other as one row."""
    groups = ((row, [i for i, _ in group]) for row, group in groupby(enumerate(rows), key=lambda item: item[1]))
    return [(f"{name} {_span(at[0], len(at))}", *row) for row, at in groups]


def _ranges(names: Sequence[str]) -> str:
    """List names, with three or more consecutive numbers of one name as a range."""

    def series(item: tuple[int, str]) -> tuple[str, int]:
        stem, _, number = item[1].rpartition("_")
        return (stem, int(number) - item[0]) if number.isdigit() else (item[1], 0)

    groups = ([name for _, name in group] for _, group in groupby(enumerate(names), key=series))
    return ", ".join(f"{code(one[0])} to {code(one[-1])}" if len(one) > 2 else codes(one) for one in groups)


def amount_words(amounts: Mapping[str, float]) -> str:
    """Format amounts of materials (mol)."""
    return ", ".join(f"{amount:g} mol `{name}`" for name, amount in amounts.items()) or "nothing"


# -- spaces -----------------------------------------------------------------------------------------------------------


def space_words(space: Any) -> str:
    """``Discrete(n)`` or ``Box(size)``."""
    return f"Discrete({space.n})" if isinstance(space, gymnasium.spaces.Discrete) else f"Box({space.shape[0]})"


def _errors(workplace: Workplace, name: str) -> str:
    """Describe noise and resolution, as shares of full scale, of a channel that its agent does not observe exactly."""
    if not isinstance(workplace, Bench):
        return ""
    if name in blank_channels(workplace):
        return "; always 0"
    errors = {"noise": workplace.spec.noise, "resolution": workplace.spec.resolution}
    return "".join(f"; {what} {values[name]:g}" for what, values in errors.items() if name in values)


def channel_table(workplace: Workplace) -> FactTable:
    """Return a row for each channel; channels that are the same for every slot of the shelf are listed once."""
    channels = workplace.channels
    first = [channel for channel in channels if channel.name.startswith("slot_0_")]
    slots = len({channel.name.split("_")[1] for channel in channels if channel.name.startswith("slot_")})
    width = sum(channel.size for channel in first)
    rows, at = [], 0
    for channel in channels:
        place, name = _span(at, channel.size), channel.name
        at += channel.size
        if name.startswith("slot_"):
            if channel not in first:
                continue
            if slots > 1:
                place, name = f"{width} s + {place}", name.replace("slot_0_", "slot_s_")
        bounds = "" if channel.unit in ("one-hot", "0 or 1", "fraction") else f"{channel.low:g} to {channel.high:g} "
        meaning = channel.meaning + _errors(workplace, name)
        rows.append((place, code(name), channel.size, bounds + channel.unit, meaning))
    note = f"s is the slot, 0 to {slots - 1}." if slots > 1 else ""
    return _facts(("index", "channel", "size", "0 to 1 stands for", "meaning"), rows, (2,), note)


def action_list(meanings: Sequence[str], discrete: bool) -> FactTable:
    """Return a row for each discrete action, or for each number of a continuous one."""
    head = ("action", "what it does") if discrete else ("number", "0 to 1 stands for")
    return _facts(head, enumerate(meanings), (0,))


def action_table(meanings: Sequence[str], discrete: bool) -> FactTable:
    """Return a row for each number of a continuous action, or for each process of a table of discrete ones."""
    if not discrete:
        return action_list(meanings, discrete)
    rows, at = [], 0
    for process, group in groupby(meanings, key=lambda meaning: meaning.rpartition(", ")[0] or meaning):
        same = list(group)
        magnitudes = ", ".join(meaning.removeprefix(process).removeprefix(", ") for meaning in same)
        rows.append((_span(at, len(same)), process, magnitudes))
        at += len(same)
    return _facts(("action", "what it does", "magnitudes"), rows)


def manager_action_table(labs: Laboratories) -> FactTable:
    """Return the manager's actions by kind, with the first and the last of each."""
    rows, at = [], 0
    for kind, group in groupby(range(len(labs.actions)), key=lambda action: labs.actions.decode(action)[0]):
        numbers = list(group)
        words = [labs.actions.words(n) for n in (numbers[0], numbers[-1])]
        rows.append((_span(at, len(numbers)), code(kind), len(numbers), " ... ".join(dict.fromkeys(words))))
        at += len(numbers)
    return _facts(("action", "kind", "number", "meaning"), rows, (2,))


def agent_table(labs: Laboratories) -> FactTable:
    """Return every agent's spaces."""
    rows = [
        (code(agent), f"Box({labs.observation_sizes[n]})", space_words(labs.action_space(n)))
        for n, agent in enumerate(labs.agents)
    ]
    return _facts(("agent", "observation", "actions"), rows)


# -- the scenario -----------------------------------------------------------------------------------------------------


def goal_words(spec: Scenario) -> list[str]:
    """Describe the orders and goals in sentences."""
    orders = "one order" if spec.orders == 1 else f"{spec.orders} orders"
    several = "one of " if len(spec.lab_goals) > 1 else ""
    return [
        f"An episode has {orders}, for {several}{codes(spec.lab_goals)}.",
        f"Experiments may be run for {codes(spec.goals)}.",
        f"Theoretical maximum: {amount_words(spec.theoretical_maximum_mol)}.",
        *(f"`{goal}` {needed_words(goal, wanted)}." for goal, wanted in spec.specifications.items()),
        *_demand_words(spec.demand),
    ]


def _demand_words(demand: DemandSpec) -> list[str]:
    """Describe the payment of orders, and when the manager learns it."""

    def share(of: float) -> str:
        return f"{of:g} of it" if of else "nothing"

    words = []
    if demand.order:
        less = f"{share(demand.late)} if that is late, and {share(demand.short)} if it is too little or too impure"
        less = less if demand.late or demand.short else "and nothing otherwise"
        words.append(f"An order pays its price for a submission that meets it in time, {less}.")
    if demand.missed:
        words.append(f"An order that pays nothing costs {demand.missed:g}{' of its price' * bool(demand.order)}.")
    if demand.fill_at_least:
        words.append(f"Only a vessel whose fill level reads at least {demand.fill_at_least:g} may be submitted.")
    if demand.feedback:
        noise = "at the end of the episode"
        if demand.feedback != "none":
            noise = f"at once, with a noise of {demand.feedback:g}"
        words.append(f"The manager learns the payment of a submission {noise}.")
    return words


def order_table(spec: Scenario) -> FactTable:
    """Return the terms of each order."""
    rows = [
        (
            f"{order.arrives:g}",
            "" if order.within is None else f"{order.within:g}",
            *(f"{value:g}" for value in (order.price, order.amount_at_least_mol, order.purity_at_least)),
        )
        for order in spec.demand.order
    ]
    head = ("order", "arrives (tick)", "due within (ticks)", "price", "least mol", "least purity")
    note = "draws below may change these" if spec.world.draws else ""
    return _facts(head, _alike("order", rows), range(1, 6), note)


def needed_words(goal: str, wanted: ProductSpec) -> str:
    """Describe what a goal needs in order to be worth anything, and its purity, as the predicate of a sentence."""
    others = [one for one in wanted.purity_among if one != goal]
    among = f" among {codes(others)} and itself" if others else ""
    least = [f"{wanted.amount_at_least_mol:g} mol"] if wanted.amount_at_least_mol else []
    least += [f"a purity of {wanted.purity_at_least:g}{among}"] if wanted.purity_at_least else []
    words = [f"needs at least {' and '.join(least)}, or is worth nothing"] if least else []
    if not wanted.purity_at_least and (among or not least):
        words.append(f"is judged by its purity{among}")
    return ", and ".join(words)


def vessel_table(spec: Scenario) -> FactTable:
    """Return the vessels at the start of an episode."""
    rows = ((f"{vessel.capacity_l:g} L", amount_words(vessel.contents)) for vessel in spec.shelf.vessel)
    return _facts(("place", "capacity", "contents"), _alike("slot", rows))


_HIDDEN = {
    "identity": "which material a vessel holds",
    "titre": "strength of the feeds",
    "amount": "contents of the vessels",
    "pre_exponential": "rate constants",
    "formation": "heat of reaction",
    "gain": "condition of the equipment",
    "arrives": "orders to come",
}
"""Hidden parameters by kind; kinds drawn together with another kind have no entry."""


def hidden_words(spec: Scenario) -> list[str]:
    """Return what a scenario hides from its agents, by kind."""
    kinds = {draw.what for draw in spec.world.draws.values()}
    return [words for kind, words in _HIDDEN.items() if kind in kinds]


def world_table(spec: Scenario) -> FactTable:
    """Return the hidden parameters of an episode, and whether a number is a factor, an offset or a value."""
    rows = []
    for name, draw in spec.world.draws.items():
        numbers = draw.distribution.model_dump(exclude_none=True)
        kind = numbers.pop("kind")
        words = ", ".join(
            f"{key} {', '.join(map(str, value)) if isinstance(value, tuple) else f'{value:g}'}"
            for key, value in numbers.items()
            if value != ()
        )
        what = f"{draw.what} of {code(draw.material)}" if draw.material else draw.what
        whose = _ranges(draw.of) or "the laboratory"
        each = "one number" if draw.variables == 1 else "each its own"
        changes = draw.what not in ("identity", "titre")  # which are values
        change = {"factor": "x ", "offset": "+ ", "value": "= "}[draw.change] if changes else ""
        unseen = "manager, on arrival" if draw.what in ORDER_QUANTITIES else "no agent"
        who = "all agents" if spec.world.revealed else codes(draw.told) or unseen
        rows.append((code(name), what, whose, f"{change}{kind}: {words}", each, who))
    note = "x: multiplies the stated value, +: is added to it, =: replaces it"
    head = ("draw", "what", "of", "drawn from", "shared", "observed by")
    return _facts(head, rows, note=note if rows else "")


def grade_table(spec: Scenario) -> FactTable:
    """Return the quality requirements that the manager may set for an experiment."""
    rows = [
        (code(name), f"{grade.amount_at_least_mol:g}", f"{grade.purity_at_least:g}", grade.ticks or "step limit")
        for name, grade in spec.grades.items()
    ]
    return _facts(("grade", "least mol", "least purity", "most ticks"), rows, range(1, 4))


def report_words(spec: Scenario) -> list[str]:
    """Describe the benches' reports in a sentence."""
    noise = {key: bench.report for key, bench in spec.benches.items() if bench.report is not None}
    listed = ", ".join(f"`{key}` ({value:g})" for key, value in noise.items())
    return [f"Benches that report their outcomes to the manager, with the noise: {listed}."] if noise else []


def stock_table(spec: Scenario) -> FactTable:
    """Return the bottles and their prices."""
    prices = spec.costs.stock_per_mol
    rows = [(code(name), f"{mol:g}", _number(prices.get(name, 0.0))) for name, mol in spec.stock.items()]
    return _facts(("bottle", "mol", "price a mol"), rows, (1, 2))


def _accuracy(spec: InstrumentSpec) -> str:
    """Describe noise and other errors of a reading."""
    words = [f"{spec.noise:g}"]
    if (spec.gain, spec.bias) != (1.0, 0.0):
        words.append(f"{spec.gain:g} x {spec.bias:+g}")
    if spec.detection_limit:
        words.append(f"0 below {spec.detection_limit:g}")
    if spec.drift is not None:
        drift = spec.drift
        words.append(
            f"off by {drift.first:g} at first, {drift.walk:g} x root of ticks"
            + (f" {drift.trend:+g} a tick" if drift.trend else "")
            + f", {drift.error:g} after a calibration for {drift.price:g}"
        )
    return "; ".join(words)


def instrument_table(labs: Laboratories) -> FactTable:
    """Return the instruments of the characterization bench."""
    rows = [
        (code(name), kind.summary, f"{i.price:g}", f"{i.sample_fraction:g}", _accuracy(i))
        for (name, i), kind in zip(labs.scenario.instruments.items(), labs.instruments.kinds, strict=True)
    ]
    return _facts(("instrument", "reading", "price", "sample", "noise"), rows, (2, 3, 4))


def bench_table(labs: Laboratories) -> FactTable:
    """Return each kind of bench: number, step limit, and score of an experiment."""
    rows = [
        (code(bench.key), bench.spec.kind, bench.spec.count, bench.spec.step_limit, bench.score_meaning)
        for bench in {bench.key: bench for bench in labs.benches}.values()
    ]
    return _facts(("bench", "kind", "number", "step limit", "score of an experiment"), rows, (2, 3))


def wear_words(spec: Scenario) -> list[str]:
    """Describe the degradation of benches in sentences, those of equal benches together."""
    alike: dict[tuple[str, str], list[str]] = {}
    for key, bench in spec.benches.items():
        if bench.wear is not None:
            wear = bench.wear
            does = {"stir": "Stirring", "heat": "Heating"}[wear.actuator]
            parts = [f" has {wear.gain:g} times its effect"]
            parts += [f"give or take a factor of e^{wear.spread:g}"] if wear.spread else []
            parts += [f"drifting by a factor of e^{wear.drift:g} in a tick of work"] if wear.drift else []
            parts += [f"until it breaks after {wear.life:g} ticks of work in the mean"] if wear.life else []
            repair = f" A repair costs {wear.repair_price:g} and takes {wear.repair_ticks} ticks."
            words = f"{', '.join(parts)}.{repair if wear.repair_price or wear.repair_ticks else ''}"
            alike.setdefault((does, words), []).append(code(key))
    return [f"{does} at a new or repaired {' or '.join(keys)}{words}" for (does, words), keys in alike.items()]


def limit_words(spec: Scenario) -> str:
    """Describe the limits of an episode, and the prices of time, waste and invalid actions."""
    limits, costs = spec.limits, spec.costs
    return (
        f"At most {limits.manager_actions} manager actions and {limits.ticks} ticks; at most {limits.budget:g} may be "
        f"spent on measuring. A tick costs {_number(costs.tick)}, a litre of waste {costs.waste_per_l:g}, an invalid "
        f"action {costs.illegal_action:g}."
    )


def safety_words(spec: Scenario) -> str:
    """Describe the weights and the price of safety events."""
    weights = ", ".join(f"`{kind}` {weight:g}" for kind, weight in spec.safety.weights.items())
    price = spec.safety.reward_price
    change = f"A unit of that cost lowers the reward by {price:g}." if price else "That cost does not lower the reward."
    return f'Weights of safety events in `info["cost"]`: {weights}. {change}'


def reward_words(spec: Scenario) -> str:
    """Describe the reward mix."""
    mix = spec.rewards
    return (
        f"Reward mix: a bench gets {mix.bench_local:g} x its own pay + {mix.bench_team:g} x the manager's result; the "
        f"manager gets {mix.manager_local + mix.manager_team:g} x its result."
    )


# -- all of it, for programs ------------------------------------------------------------------------------------------


def description(labs: Laboratories, agents: Sequence[str] | None = None) -> dict[str, Any]:
    """Return a JSON-compatible description of the laboratory.

    Args:
        labs: the laboratories.
        agents: agents whose spaces are included (default: all).

    Returns:
        The scenario's keys (hidden parameters under ``world``), ``file``, and under ``agents`` for each of them
        ``kind``, ``score`` (score of an experiment, or of an episode for the manager), ``step_limit`` (maximum number
        of its actions), ``observation`` (``size``, and ``channels`` with ``start`` and ``stop`` index, name, unit,
        bounds, meaning) and ``actions`` (``discrete``, and ``meanings`` by index).
    """
    spec = labs.scenario
    keys = {"name", "title", "summary", "goals", "lab_goals", "orders", "theoretical_maximum_mol", "stock", "shelf"}
    keys |= {"instruments", "limits", "costs", "safety", "rewards", "demand", "specifications"}
    keys |= {"benches", "grades", "world"}
    told: dict[str, Any] = {}
    for agent in labs.agents if agents is None else agents:
        number = labs.agents.index(agent)
        role = labs.roles[number].workplace
        channels, at = [], 0
        for channel in role.channels:
            channels.append({"start": at, "stop": at + channel.size, **asdict(channel)})
            at += channel.size
        told[agent] = {
            "kind": role.kind,
            "score": role.score_meaning,
            "step_limit": role.step_limit,
            "observation": {"size": at, "channels": channels},
            "actions": {"discrete": labs.action_counts[number] > 0, "meanings": list(role.action_meanings)},
        }
    return {**spec.model_dump(mode="json", include=keys), "file": spec.origin, "agents": told}
