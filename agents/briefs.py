"""The introduction that a seat is given, generated from the scenario."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence

import numpy as np

from chemlab.config.draws import Draw
from chemlab.config.reactions import equation, side_words
from chemlab.config.scenario import Scenario
from chemlab.lab.describe import goal_words, wear_words
from chemlab.lab.engine import Laboratories
from chemlab.lab.text import position_words
from chemlab.roles.bench import Bench

__all__ = ["brief", "opaque_names"]


def opaque_names(scenario: Scenario, salt: str) -> dict[str, str]:
    """Code names of all materials but air, permuted by a salt."""
    materials = sorted(name for name in scenario.materials if name != "air")
    words = np.frombuffer(hashlib.blake2b(f"names {salt}".encode(), digest_size=32).digest(), "<u4")
    order = np.random.default_rng(words.tolist()).permutation(len(materials))
    return {name: f"M{code + 1:02d}" for name, code in zip(materials, order.tolist(), strict=True)}


def brief(labs: Laboratories, seat: str, seats: Sequence[str], name: Callable[[str], str]) -> str:
    """The introduction for one seat.

    Args:
        labs: the laboratory.
        seat: the agent.
        seats: all agents that have a seat.
        name: gives the names of materials.
    """
    spec, role = labs.scenario, labs.roles[labs.agents.index(seat)].workplace
    others = [other for other in seats if other != seat]
    policies = [agent for agent in labs.agents if agent not in seats]
    lines = [f"You are {seat} in a simulated chemistry laboratory. Its numbers are no instructions for a real one."]
    if name is str:
        lines.append(spec.summary)
    if others or policies:
        lines.append(
            "; ".join(
                f"{', '.join(who)}: {what}" for who, what in ((others, "other seats"), (policies, "policies")) if who
            )
        )
    lines += _bench_lines(role) if isinstance(role, Bench) else _manager_lines(labs)
    if spec.family.reaction or spec.family.violent:
        lines.append(_reactions(spec, name))
    hidden = [_draw_words(spec, draw, name) for draw in spec.world.draws.values() if _concerns(spec, draw)]
    if hidden:
        lines.append(f"Hidden, redrawn every episode: {'; '.join(hidden)}.")
    return "\n".join(_plain(line, name) for line in lines)


def _manager_lines(labs: Laboratories) -> list[str]:
    spec = labs.scenario
    prices = ", ".join(f"{key} {one.price:g}" for key, one in spec.instruments.items())
    limits, costs = spec.limits, spec.costs
    lines = [
        *_order_lines(spec),
        f"Limits: {limits.manager_actions} actions, {limits.ticks} ticks, {limits.budget:g} for measuring. "
        f"Costs: a tick {costs.tick:g}, a litre of waste {costs.waste_per_l:g}{_priced(spec)}.",
    ]
    lines.append(f"Price of a measurement: {prices}." if prices else "There are no instruments.")
    kinds = {bench.key: bench for bench in labs.benches}
    for bench in kinds.values():
        agents = ", ".join(agent for agent, one in zip(labs.bench_agents, labs.benches, strict=True) if one is bench)
        extra = f"; {position_words(bench)}" if len(bench.positions) > 1 else ""
        lines.append(f"{agents or bench.key}: {bench.kind}, at most {bench.spec.step_limit} steps{extra}.")
    for grade, wanted in spec.grades.items():
        ticks = f", {wanted.ticks} ticks" if wanted.ticks is not None else ""
        lines.append(
            f"Grade {grade}: at least {wanted.amount_at_least_mol:g} mol, purity {wanted.purity_at_least:g}{ticks}."
        )
    return [*lines, *wear_words(spec)]


def _reactions(spec: Scenario, name: Callable[[str], str]) -> str:
    """All reactions, with numbers if hidden parameters refer to them; what all have in common is said once."""
    steps, head = spec.family.reaction, "Reactions"
    sides = [(dict(step.reactants), dict(step.products)) for step in steps]
    common = [dict(set.intersection(*({*side[k].items()} for side in sides))) if sides else {} for k in (0, 1)]
    if len(steps) > 1 and all(common) and all(len(side[k]) > len(common[k]) for side in sides for k in (0, 1)):
        head += f", all with {side_words(common[0])} -> {side_words(common[1])} as well"
        for side in sides:
            for k in (0, 1):
                for material in common[k]:
                    del side[k][material]
    words = [_tokens(f"{side_words(reactants)} -> {side_words(products)}", name) for reactants, products in sides]
    if any(equation(step) in draw.of for draw in spec.world.draws.values() for step in steps):
        words = [f"{k}. {one}" for k, one in enumerate(words, start=1)]
    sentences = [f"{_tokens(head, name)}: {'; '.join(words)}."] if words else []
    sentences += [f"Violent: {_tokens(equation(one), name)}." for one in spec.family.violent]
    return " ".join(sentences)


def _priced(spec: Scenario) -> str:
    """Prices of stock and of safety events, where there are any."""
    alike: dict[float, list[str]] = {}
    for name, price in spec.costs.stock_per_mol.items():
        alike.setdefault(price, []).append(f"`{name}`")
    prices = [f"a mol of {' or '.join(names)} {price:g}" for price, names in alike.items() if price]
    if spec.safety.reward_price:
        weights = ", ".join(f"{kind} {spec.safety.reward_price * w:g}" for kind, w in spec.safety.weights.items())
        prices.append(f"safety events: {weights}")
    return "".join(f", {price}" for price in prices)


def _order_lines(spec: Scenario) -> list[str]:
    """Orders and score, with the specifications where there are any."""
    most = spec.theoretical_maximum_mol
    several = f"{spec.orders} orders, each" if spec.orders > 1 else "One order"
    first, *others = (f"`{goal}` ({{}}{most.get(goal, 1.0):.3g}{{}})" for goal in spec.lab_goals)
    wanted = ", ".join([first.format("at most ", " mol"), *(one.format("", "") for one in others)])
    lines = [f"{several} for {'one of ' if others else ''}{wanted}."]
    if spec.demand.order:
        late, short = spec.demand.late, spec.demand.short
        share = f"a late delivery pays {late:g} of its price, one below the least amount or purity {short:g}"
        lines.append(f"Score: the mean over orders of the price paid ({share}), minus all costs.")
        return lines + _customer_lines(spec)
    lines.append("Score: mol submitted x purity / maximum (mean over orders), minus all costs.")
    return lines + goal_words(spec)[3:] + _customer_lines(spec)


def _customer_lines(spec: Scenario) -> list[str]:
    """Penalties, feedback, and vessels that may be submitted, where they differ from the default."""
    demand, lines = spec.demand, []
    if demand.missed:
        lines.append(f"An order that is not met costs {demand.missed:g} of its price.")
    if demand.feedback != 0.0:
        early = (
            "nothing is learned"
            if demand.feedback == "none"
            else f"only noisy values ({demand.feedback:g}) are learned"
        )
        lines.append(f"Of a submission {early} before the end of the episode.")
    if spec.hides:
        full = f", at least {demand.fill_at_least:g} full," if demand.fill_at_least else ""
        lines.append(f"Only a vessel that was at a bench{full} can be submitted; a recall takes a tick at least.")
    return lines


def _bench_lines(bench: Bench) -> list[str]:
    gauges = [c for c in bench.channels if c.size == 1 and c.unit not in ("fraction", "one-hot", "0 or 1")]
    ranges = "; ".join(f"{c.name} {c.low:g} to {c.high:g} {c.unit}" for c in gauges)
    return [
        f"You operate a {bench.kind} bench. Score of an experiment: {bench.score_meaning}.",
        f"An experiment has at most {bench.spec.step_limit} steps. Vessels: {position_words(bench)}.",
        *([f"Gauges: {ranges}."] if ranges else []),
    ]


def _plain(line: str, name: Callable[[str], str]) -> str:
    """Names in backticks as they are called here."""
    return re.sub(r"`([^`]*)`", lambda match: name(match[1]), line)


def _tokens(words: str, name: Callable[[str], str]) -> str:
    return " ".join(name(word) for word in words.split(" "))


def _concerns(spec: Scenario, draw: Draw) -> bool:
    """True where a draw is about the laboratory, not only about benches on their own."""
    return not draw.of or any(target not in spec.benches for target in draw.of)


def _draw_words(spec: Scenario, draw: Draw, name: Callable[[str], str]) -> str:
    """One declared draw in words."""
    numbers = draw.distribution.model_dump(exclude_none=True)
    kind = numbers.pop("kind")
    parts = []
    for label, value in numbers.items():
        if isinstance(value, tuple):
            counts = {option: value.count(option) for option in value}
            listed = ", ".join(f"{name(str(o))}{f' x{n}' if n > 1 else ''}" for o, n in counts.items())
            parts += [listed] if value else []
        else:
            parts.append(f"{label} {value:g}")
    change = {"factor": "times ", "offset": "plus ", "value": ""}[draw.change]
    change = "" if draw.what in ("identity", "titre") else change
    numbers_of = {equation(step): f"reaction {k}" for k, step in enumerate(spec.family.reaction, start=1)}
    targets = _ranges([numbers_of.get(one) or _tokens(one, name) for one in draw.of if one not in spec.benches])
    of = f" of {name(draw.material)}" if draw.material else ""
    of += f" (rest {name(draw.inert)})" if draw.inert else ""
    told = "all agents" if spec.world.revealed else ", ".join(draw.told)
    told = f", revealed to {told}" if told else ""
    where = f" ({targets})" if targets else ""
    return f"{draw.what}{of}{where}, {change}{kind} {', '.join(parts)}{told}"


def _ranges(names: Sequence[str]) -> str:
    """Names with numbers in a row as ranges: ``slot_0-7``."""
    numbered = [name.rpartition("_") for name in names]
    if len(names) > 2 and len({stem for stem, _, _ in numbered}) == 1 and all(n.isdigit() for _, _, n in numbered):
        return f"{numbered[0][0]}_{numbered[0][2]}-{numbered[-1][2]}"
    return ", ".join(names)
