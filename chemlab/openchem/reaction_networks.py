"""Random balanced reaction networks: a route from feeds to a product, and side reactions.

A network has invented elements. Every feed consists of one atom of a separate element, and some carry a second atom
that leaves in a coproduct. A product of the route contains the remaining atoms of its feeds. The yield is therefore
limited only by the feeds, and the reactions of the route in sequence reach the maximum.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeVar

from ..config.datafile import DataError

MOST_MATERIALS = 40
_MOST_STEPS = 8
_MOST_PER_STEP = 6
"""Number of materials per step of the route above which a longer route is chosen."""
_CONVERGES = 0.35
"""Probability that a step begins a second branch if there is room for one."""

T = TypeVar("T")
Kind = Literal["main", "isomer", "rearranged", "overreacted", "dimer"]


class Draws:
    """Random numbers that do not depend on the machine or the versions of Python and NumPy.

    All are derived from ``random.Random.random``, whose sequence Python guarantees.

    Args:
        seed: numbers and words that form the seed.
    """

    def __init__(self, *seed: object) -> None:
        self._next = random.Random(" ".join(map(str, seed))).random

    def between(self, low: float, high: float) -> float:
        """Return a number from ``low`` to ``high``."""
        return low + (high - low) * self._next()

    def whole(self, low: int, high: int) -> int:
        """Return an integer from ``low`` to ``high``, both included."""
        return low + min(int(self._next() * (high - low + 1)), high - low)

    def happens(self, probability: float) -> bool:
        """Return True with this probability."""
        return self._next() < probability

    def one_of(self, things: Sequence[T]) -> T:
        """Return a random element."""
        return things[int(self._next() * len(things))]

    def some_of(self, things: Sequence[T], number: int) -> list[T]:
        """Return a number of distinct random elements in their original order."""
        chosen: list[T] = []
        for i, thing in enumerate(things):
            if self._next() * (len(things) - i) < number - len(chosen):
                chosen.append(thing)
        return chosen


@dataclass(frozen=True)
class Size:
    """Size of a network.

    Attributes:
        steps: reactions of the route, which has ``steps`` products and one more feed.
        materials: number of materials, without solvents.
        reactions: number of reactions, side reactions included.
    """

    steps: int
    materials: int
    reactions: int

    @property
    def others(self) -> int:
        """Number of by-products and coproducts."""
        return self.materials - 2 * self.steps - 1

    @property
    def side_reactions(self) -> int:
        """Number of side reactions."""
        return self.reactions - self.steps


@dataclass(frozen=True)
class Step:
    """A reaction; all coefficients are 1 except that of a dimer's halves.

    Attributes:
        kind: ``main``, or the kind of side reaction: to an isomer of the product (directly or from the product), a
            further reaction of the product, or a reaction of a reactant with itself.
        beside: index of the competing main step; a main step's own index.
        reactants, products: coefficients.
        catalyst: required catalyst, if any.
    """

    kind: Kind
    beside: int
    reactants: dict[str, int]
    products: dict[str, int]
    catalyst: str = ""


@dataclass
class Network:
    """Materials and reactions by name.

    Attributes:
        atoms: composition of every material, in the order feeds, products of the route, coproducts, by-products.
        feeds, route: starting materials; products of the route in order, the last one made of all feeds.
        coproducts: coproducts by their element.
        byproducts: products of side reactions.
        isomers: by-products with the composition of a product of the route, and that product.
        steps: reactions, main steps first.
    """

    atoms: dict[str, dict[str, int]] = field(default_factory=dict)
    feeds: list[str] = field(default_factory=list)
    route: list[str] = field(default_factory=list)
    coproducts: list[str] = field(default_factory=list)
    byproducts: list[str] = field(default_factory=list)
    isomers: dict[str, str] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)


def chosen_size(usual: Size, materials: int | None, reactions: int | None, steps: int | None) -> Size:
    """Return a size for which networks exist.

    Args:
        usual: default size; values that are None are adapted from it.
        materials, reactions, steps: requested values.

    Raises:
        DataError: no network has this size; the message states the possible ones.
    """
    given = {"materials": materials, "reactions": reactions, "steps": steps}
    for name, value, low, high in (
        ("materials", materials, 3, MOST_MATERIALS),
        ("reactions", reactions, 1, 2 * MOST_MATERIALS - 5),
        ("steps", steps, 1, _MOST_STEPS),
    ):
        if value is not None and not low <= value <= high:
            raise DataError(f"{name} = {value}: must be from {low} to {high}")
    middle = usual.steps if materials is None else max(usual.steps, -(-materials // _MOST_PER_STEP))
    for route in _near(middle, 1, _MOST_STEPS) if steps is None else [steps]:
        for others in range(MOST_MATERIALS - 2 * route) if materials is None else [materials - 2 * route - 1]:
            least, most = max(route, others), route + 2 * others
            if others < 0 or (reactions is None and materials is None and others != usual.others):
                continue
            if reactions is None:
                return Size(route, 2 * route + 1 + others, min(route + max(others, usual.side_reactions), most))
            if least <= reactions <= most:
                return Size(route, 2 * route + 1 + others, reactions)
    requested = ", ".join(f"{name} = {value}" for name, value in given.items() if value is not None)
    raise DataError(
        f"{requested}: there is no such network: a route of S steps has 2 S + 1 materials; with O other materials, it "
        "has at least S and at least O reactions, and at most S + 2 O; omit one of the numbers, and it is chosen to fit"
    )


def _near(middle: int, low: int, high: int) -> list[int]:
    """Return the integers from ``low`` to ``high``, ordered by distance to ``middle``."""
    return sorted(range(low, high + 1), key=lambda number: (abs(number - middle), number))


def draw_network(draws: Draws, size: Size, catalysed: bool = False) -> Network:
    """Draw a random network of a size.

    Args:
        draws: random numbers.
        size: size returned by :func:`chosen_size`.
        catalysed: whether one of a product's reactants catalyses its rearrangement; otherwise the pure product would
            rearrange and could not be distilled.
    """
    network = Network()
    pairs = _route(draws, size.steps)
    # An isomer has one or two side reactions, another by-product has one; the other materials are coproducts.
    most = size.others - -(-size.side_reactions // 2)
    fewest = max(0, size.others - size.side_reactions)
    leaving = draws.whole(fewest, min(most, size.steps))
    _add_route(network, draws, pairs, draws.some_of(range(size.steps), leaving))
    _add_byproducts(network, draws, size.others - leaving, size.side_reactions)
    for i, step in enumerate(network.steps):
        if catalysed and step.kind == "rearranged":
            catalyst = draws.one_of(list(network.steps[step.beside].reactants))
            network.steps[i] = replace(step, catalyst=catalyst)
    return network


def _route(draws: Draws, steps: int) -> list[tuple[str, str]]:
    """Return the two reactants of each step: feeds ``A1``, ``A2``, ... and products ``P1``, ``P2``, ..., as a tree."""
    feeds, waiting, pairs = 0, list[str](), list[tuple[str, str]]()
    for j in range(steps):
        left = steps - j
        if not waiting or (left > len(waiting) and left >= 2 and draws.happens(_CONVERGES)):
            pair, feeds = (f"A{feeds + 1}", f"A{feeds + 2}"), feeds + 2
        elif left == len(waiting) - 1:
            pair = (waiting.pop(), waiting.pop())
        else:
            pair, feeds = (waiting.pop(), f"A{feeds + 1}"), feeds + 1
        pairs.append(pair)
        waiting.append(f"P{j + 1}")
    return pairs


def _add_route(network: Network, draws: Draws, pairs: Sequence[tuple[str, str]], leaving: Sequence[int]) -> None:
    """Create the materials and main steps of the route; the steps ``leaving`` have a coproduct."""
    network.feeds = sorted((name for pair in pairs for name in pair if name[0] == "A"), key=lambda name: int(name[1:]))
    network.coproducts = [f"X{i + 1}" for i in range(len(leaving))]
    coproduct_of = dict(zip(leaving, network.coproducts, strict=True))
    for i, name in enumerate(network.feeds):
        network.atoms[name] = {f"Q{i + 1}": 1}
    for j, coproduct in coproduct_of.items():
        carrier = draws.one_of(pairs[j])
        while carrier[0] != "A":  # the leaving element of a product comes from one of its feeds
            carrier = draws.one_of(pairs[int(carrier[1:]) - 1])
        network.atoms[carrier][f"Y{coproduct[1:]}"] = 1
    for j, (first, second) in enumerate(pairs):
        product = f"P{j + 1}"
        products = {product: 1}
        atoms = {**network.atoms[first], **network.atoms[second]}
        if j in coproduct_of:
            products[coproduct_of[j]] = 1
            del atoms[f"Y{coproduct_of[j][1:]}"]
        network.atoms[product] = atoms
        network.route.append(product)
        network.steps.append(Step("main", j, {first: 1, second: 1}, products))
    for name in network.coproducts:
        network.atoms[name] = {f"Y{name[1:]}": 1}


def _add_byproducts(network: Network, draws: Draws, number: int, reactions: int) -> None:
    """Create by-products and their side reactions."""
    twice = reactions - number
    taken: set[tuple[str, str]] = set()
    for i in range(number):
        name, j = f"W{i + 1}", draws.whole(0, len(network.route) - 1)
        kind: Kind = "isomer" if i < twice else draws.one_of(("isomer", "rearranged", "overreacted", "dimer"))
        partner = draws.one_of(list(network.steps[j].reactants))
        key = ("dimer", partner) if kind == "dimer" else (kind, f"{network.route[j]} {partner}")
        if kind in ("dimer", "overreacted") and (key in taken or (kind == "overreacted" and partner[0] != "A")):
            kind = "isomer"
        taken.add(key)
        network.byproducts.append(name)
        network.steps += _side_reactions(network, kind, j, partner, name, i < twice)
        atoms: Counter[str] = Counter()
        last = network.steps[-1]
        for sign, side in ((1, last.reactants), (-1, {k: n for k, n in last.products.items() if k != name})):
            for material, times in side.items():
                for element, count in network.atoms[material].items():
                    atoms[element] += sign * times * count
        network.atoms[name] = {element: count for element, count in atoms.items() if count}
        if kind in ("isomer", "rearranged"):
            network.isomers[name] = network.route[j]


def _side_reactions(network: Network, kind: Kind, j: int, partner: str, name: str, twice: bool) -> list[Step]:
    """Return the side reactions that compete with main step ``j`` and make the by-product ``name``.

    ``partner`` is the reactant of a dimer or a further reaction. If ``twice``, an isomer is formed both directly and
    from the product.
    """
    main, product = network.steps[j], network.route[j]
    leaving = {key: 1 for key in main.products if key != product}
    if kind == "dimer":
        return [Step(kind, j, {partner: 2}, {name: 1})]
    if kind == "overreacted":
        carries = any(f"Y{key[1:]}" in network.atoms[partner] for key in leaving)
        return [Step(kind, j, {product: 1, partner: 1}, {name: 1, **(leaving if carries else {})})]
    parallel = Step("isomer", j, dict(main.reactants), {name: 1, **leaving})
    later = Step("rearranged", j, {product: 1}, {name: 1})
    return [parallel, later] if twice else [later if kind == "rearranged" else parallel]
