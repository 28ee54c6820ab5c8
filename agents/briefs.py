"""Introduction (brief) for a seat, generated from the scenario."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from chemlab.config.draws import Draw
from chemlab.config.reactions import equation, side_words
from chemlab.config.scenario import GradeSpec, Scenario
from chemlab.lab.describe import needed_words, report_words, wear_words
from chemlab.lab.engine import Laboratories
from chemlab.lab.text import blank_channels, noisy_channels, position_words
from chemlab.roles.bench import Bench

_ACTUATORS = {"stir": "stirring", "heat": "heating"}
_UNITS = {
    "arrives": " ticks",
    "within": " ticks",
    "formation": " J/mol",
    "activation_energy": " J/mol",
    "fusion": " J/mol",
    "melting": " K",
    "ambient_temperature": " K",
}
"""Units of drawn numbers, as far as their names do not have them."""
_FEW = 2
"""Maximum number of goals whose theoretical maxima are listed with the orders instead of the reactions."""


def opaque_names(scenario: Scenario, salt: str) -> dict[str, str]:
    """Return code names of all materials except air, {name: code}, permuted by a salt."""
    materials = sorted(name for name in scenario.materials if name != "air")
    words = np.frombuffer(hashlib.blake2b(f"names {salt}".encode(), digest_size=32).digest(), "<u4")
    order = np.random.default_rng(words.tolist()).permutation(len(materials))
    return {name: f"M{code + 1:02d}" for name, code in zip(materials, order.tolist(), strict=True)}


def brief(labs: Laboratories, seat: str, seats: Sequence[str] | None, name: Callable[[str], str]) -> str:
    """Return the introduction for one seat.

    Args:
        labs: the laboratory.
        seat: the agent.
        seats: all agents that have a seat; None if people may take and leave the seats.
        name: returns the displayed name of a material.
    """
    spec, role = labs.scenario, labs.roles[labs.agents.index(seat)].workplace
    others = [other for other in seats or () if other != seat]
    policies = [agent for agent in labs.agents if agent not in (seats or (seat,))]
    lines = [f"You are {seat} in a simulated laboratory, whose numbers are no instructions for a real one."]
    if name is str:
        lines.append(spec.summary.partition(". ")[0].rstrip(".") + ".")
    if others and policies:
        lines.append(f"{', '.join(others)}: other seats; {', '.join(policies)}: policies")
    elif others or policies:
        players = "seats" if others else "policies" if seats else "policies or people"
        lines.append(f"All other agents: {players}")
    maxima = {} if isinstance(role, Bench) else _product_maxima(spec)
    lines += _bench_lines(role) if isinstance(role, Bench) else _manager_lines(labs, maxima)
    if spec.family.reaction or spec.family.violent:
        lines.append(_reactions(spec, name, maxima))
    # Draws that only affect single benches outside a laboratory are omitted.
    draws = [(k, d) for k, d in spec.world.draws.items() if not d.of or not spec.benches.keys() >= set(d.of)]
    hidden = [_draw_words(spec, key, draw, name) for key, draw in draws]
    if hidden:
        lines.append(f"Hidden, redrawn every episode: {'; '.join(hidden)}.")
    # Texts of the scenario have names of materials in backticks.
    return "\n".join(re.sub(r"`([^`]*)`", lambda match: name(match[1]), line) for line in lines)


def _product_maxima(spec: Scenario) -> dict[str, float]:
    """Return the theoretical maxima (mol) to list behind the reactions, by goal.

    They are those of goals without a specification that one reaction produces; none if there are few.
    """
    products = [product for step in spec.family.reaction for product in dict(step.products)]
    goals = [goal for goal in spec.lab_goals if goal not in spec.specifications and products.count(goal) == 1]
    return {goal: spec.theoretical_maximum_mol.get(goal, 1.0) for goal in goals} if len(goals) > _FEW else {}


def _manager_lines(labs: Laboratories, maxima: Mapping[str, float]) -> list[str]:
    """Return the manager's lines: orders, limits, costs, instruments, benches, grades and degradation."""
    spec = labs.scenario
    prices = ", ".join(
        f"{key} {one.price:g}" + (f" (drifts; a calibration {one.drift.price:g})" if one.drift else "")
        for key, one in spec.instruments.items()
    )
    limits, costs = spec.limits, spec.costs
    lines = [
        *_order_lines(spec, maxima),
        f"Limits: {limits.manager_actions} actions, {limits.ticks} ticks, {limits.budget:g} for measuring. "
        f"Costs: {', '.join([f'a tick {costs.tick:g}', *_prices(spec)])}.",
        f"A measurement: {prices}." if prices else "There are no instruments.",
    ]
    for bench in {bench.key: bench for bench in labs.benches}.values():
        agents = ", ".join(agent for agent, one in zip(labs.bench_agents, labs.benches, strict=True) if one is bench)
        extra = f"; {position_words(bench)}" if len(bench.positions) > 1 else ""
        lines.append(f"{agents or bench.key}: {bench.kind}, up to {bench.spec.step_limit} steps{extra}.")
    grades = [f"{grade} ({', '.join(_grade_words(wanted))})" for grade, wanted in spec.grades.items()]
    lines += [f"Grades: {', '.join(grades)}."] if grades else []
    return [*lines, *report_words(spec), *wear_words(spec)]


def _grade_words(wanted: GradeSpec) -> list[str]:
    """Describe a quality requirement."""
    return [
        *([f"at least {wanted.amount_at_least_mol:g} mol"] if wanted.amount_at_least_mol else []),
        *([f"purity {wanted.purity_at_least:g}"] if wanted.purity_at_least else []),
        *([f"{wanted.ticks} ticks"] if wanted.ticks is not None else []),
    ]


def _reactions(spec: Scenario, name: Callable[[str], str], maxima: Mapping[str, float]) -> str:
    """List all reactions, numbered if hidden parameters refer to them. Common reactants and products are stated once.

    ``name`` returns the displayed name of a material; ``maxima`` (mol) are listed behind products.
    """
    steps, head = spec.family.reaction, "Reactions"
    sides = [(dict(step.reactants), dict(step.products)) for step in steps]
    common = [dict(set.intersection(*({*side[k].items()} for side in sides))) if sides else {} for k in (0, 1)]
    if len(steps) > 1 and all(common) and all(len(side[k]) > len(common[k]) for side in sides for k in (0, 1)):
        head += f", each with {side_words(common[0])} -> {side_words(common[1])}"
        for side in sides:
            for k in (0, 1):
                for material in common[k]:
                    del side[k][material]
    numbered = any(equation(step) in draw.of for draw in spec.world.draws.values() for step in steps)
    words: dict[str, list[str]] = {}
    for k, (reactants, products) in enumerate(sides, start=1):
        maximum = "".join(f" ({maxima[product]:.3g})" for product in products if product in maxima)
        option = f"{f'({k}) ' if numbered else ''}{renamed(side_words(products), name)}{maximum}"
        words.setdefault(renamed(side_words(reactants), name), []).append(option)
    listed = "; ".join(f"{reactants} -> {' or '.join(options)}" for reactants, options in words.items())
    sentences = [f"{renamed(head, name)}: {listed}."] if words else []
    sentences += [f"Violent: {renamed(equation(one), name)}." for one in spec.family.violent]
    return " ".join(sentences)


def _prices(spec: Scenario) -> list[str]:
    """List the prices of waste, stock and safety events that are not 0."""
    prices = [f"a litre of waste {spec.costs.waste_per_l:g}"] if spec.costs.waste_per_l else []
    stock = _priced({f"`{name}`": price for name, price in spec.costs.stock_per_mol.items()})
    events = _priced({kind: spec.safety.reward_price * weight for kind, weight in spec.safety.weights.items()})
    prices += [f"a mol of {stock}"] if stock else []
    return [*prices, f"safety events: {events}"] if spec.safety.reward_price else prices


def _priced(prices: Mapping[str, float]) -> str:
    """List names with their prices; names of the same price are grouped, and prices of 0 omitted."""
    by_price: dict[float, list[str]] = {}
    for name, price in prices.items():
        by_price.setdefault(price, []).append(name)
    return ", ".join(f"{' or '.join(names)} {price:g}" for price, names in by_price.items() if price)


def _order_lines(spec: Scenario, maxima: Mapping[str, float]) -> list[str]:
    """Return lines on orders, specifications, score, penalties, feedback, and vessels that may be submitted.

    ``maxima`` has the goals that are listed with the reactions. Defaults are not mentioned.
    """
    wanted = ["a product with its maximum (mol) behind it"] if maxima else []
    for goal in (goal for goal in spec.lab_goals if goal not in maxima):
        needs = spec.specifications.get(goal)
        needed = f"; {needed_words(goal, needs)}" if needs is not None else ""
        wanted.append(f"`{goal}` (at most {spec.theoretical_maximum_mol.get(goal, 1.0):.3g} mol{needed})")
    lines = [f"{f'{spec.orders} orders, each' if spec.orders > 1 else 'One order'} for {' or '.join(wanted)}."]
    demand = spec.demand
    if demand.order:
        late = f"a late delivery pays {demand.late:g} of its price"
        short = f"one below the least amount or purity {demand.short:g}"
        lines.append(f"Score: the mean over orders of the price paid ({late}, {short}), minus costs.")
    else:
        mean = " (mean over orders)" if spec.orders > 1 else ""
        lines.append(f"Score: mol submitted x purity / maximum{mean}, minus costs.")
    if demand.missed:
        lines.append(f"An order not met costs {demand.missed:g}{' of its price' if demand.order else ''}.")
    if demand.feedback != 0.0:
        early = "nothing is" if demand.feedback == "none" else f"only noisy values ({demand.feedback:g}) are"
        lines.append(f"Of a submission {early} learned before the end of the episode.")
    if spec.hides:
        full = f" and are {demand.fill_at_least:g} full" if demand.fill_at_least else ""
        lines.append(f"Submit only vessels that were at a bench{full}; a recall takes a tick.")
    return lines


def _bench_lines(bench: Bench) -> list[str]:
    """Return the lines of a bench's agent: score, limits, vessels, gauges and noise."""
    gauges = [c for c in bench.channels if c.size == 1 and c.unit not in ("fraction", "one-hot", "0 or 1")]
    blank = dict.fromkeys(blank_channels(bench), " (not shown)")
    ranges = "; ".join(f"{c.name} {c.low:g} to {c.high:g} {c.unit}{blank.get(c.name, '')}" for c in gauges)
    noise = ", ".join(f"{channel} {deviation:g}" for channel, deviation in bench.spec.noise.items())
    shown = " What is mostly noise is shown only at the first step, and by look." if noisy_channels(bench) else ""
    coarse = ", ".join(f"{name} {step:g}" for name, step in bench.spec.resolution.items() if name not in blank)
    return [
        f"You operate {'an' if bench.kind[0] in 'aeiou' else 'a'} {bench.kind} bench. "
        f"Score of an experiment: {bench.score_meaning}.",
        f"An experiment has at most {bench.spec.step_limit} steps. Vessels: {position_words(bench)}.",
        *([f"Gauges: {ranges}."] if ranges else []),
        *([f"Noise (of full scale): {noise}.{shown}"] if noise else []),
        *([f"Resolution (of full scale): {coarse}."] if coarse else []),
    ]


def renamed(words: str, name: Callable[[str], str]) -> str:
    """Return a text with the names of materials replaced by their displayed names."""
    return " ".join(name(word) for word in words.split(" "))


def _draw_words(spec: Scenario, key: str, draw: Draw, name: Callable[[str], str]) -> str:
    """Describe a declared draw; ``key`` is the name under which agents observe it."""
    numbers = draw.distribution.model_dump(exclude_none=True)
    kind = numbers.pop("kind")
    parts = []
    for label, value in numbers.items():
        if isinstance(value, tuple):
            counts = {option: value.count(option) for option in value}
            each = next(iter(counts.values()), 1) if len(set(counts.values())) == 1 else 0  # the same of all
            listed = ", ".join(f"{name(str(o))}{'' if each else f' x{n}'}" for o, n in counts.items())
            listed = f"{each} each of {listed}" if each > 1 else listed
            parts += [listed] if value else []
        elif label == "high" and "low" in numbers:
            parts[-1] = f"{numbers['low']:g} to {value:g}"
        else:
            parts.append(f"{label} {value:g}")
    change = {"factor": "times ", "offset": "plus ", "value": ""}[draw.change]
    change = "" if draw.what in ("identity", "titre") else change
    numbers_of = {equation(step): f"reaction {k}" for k, step in enumerate(spec.family.reaction, start=1)}
    targets = _ranges([numbers_of.get(one) or renamed(one, name) for one in draw.of if one not in spec.benches])
    of = f" of {name(draw.material)}" if draw.material else ""
    of += f" (rest {name(draw.inert)})" if draw.inert else ""
    agents = "all agents" if spec.world.revealed else ", ".join(draw.told)
    revealed = f", revealed to {agents} as {key}" if agents else ""
    where = f" ({targets.replace(', reaction ', ', ')})" if targets else ""
    actuators = [worn.actuator for one in draw.of if one in spec.benches and (worn := spec.benches[one].wear)]
    what = f"effect of {_ACTUATORS[actuators[0]]} before repairs" if actuators and draw.what == "gain" else draw.what
    unit = "" if draw.change == "factor" else _UNITS.get(draw.what, "")
    return f"{what}{of}{where}, {change}{kind} {', '.join(parts)}{unit}{revealed}"


def _ranges(names: Sequence[str]) -> str:
    """List names; three or more numbered names of one kind become a range, as ``slot_0-7``."""
    numbered = [name.rpartition("_") for name in names]
    if len(names) > 2 and len({stem for stem, _, _ in numbered}) == 1 and all(n.isdigit() for _, _, n in numbered):
        return f"{numbered[0][0]}_{numbered[0][2]}-{numbered[-1][2]}"
    return ", ".join(names)
