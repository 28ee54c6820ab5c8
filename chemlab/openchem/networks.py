"""Random reaction networks that balance: a route from feeds to a product, and what goes wrong beside it.

A network has invented elements. Every feed is the atom of an element of its own, and may carry another, which leaves in
a coproduct; a product of the route has all that its feeds keep. So nothing but the feeds limits how much there can be
of it, and one reaction after the other along the route gives as much.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeVar

from ..config.datafile import DataError

__all__ = ["MOST_MATERIALS", "Draws", "Network", "Size", "Step", "chosen_size", "draw_network"]

MOST_MATERIALS = 40
_MOST_STEPS = 8
_MOST_PER_STEP = 6
"""Materials for each step of the route, beyond which a longer one is chosen."""
_CONVERGES = 0.35
"""Probability that a step begins a second branch, where there is room for one."""

T = TypeVar("T")
Kind = Literal["main", "isomer", "rearranged", "overreacted", "dimer"]


class Draws:
    """Random numbers that are the same on every machine and with every version of Python and numpy: all come from
    ``random.Random.random``, which Python promises to keep.

    Args:
        seed: numbers and words that together say which ones.
    """

    def __init__(self, *seed: object) -> None:
        self._next = random.Random(" ".join(map(str, seed))).random

    def between(self, low: float, high: float) -> float:
        """A number from ``low`` to ``high``."""
        return low + (high - low) * self._next()

    def whole(self, low: int, high: int) -> int:
        """A whole number from ``low`` to ``high``, both included."""
        return low + min(int(self._next() * (high - low + 1)), high - low)

    def happens(self, probability: float) -> bool:
        """Whether something of this probability happens."""
        return self._next() < probability

    def one_of(self, things: Sequence[T]) -> T:
        """One of some things."""
        return things[int(self._next() * len(things))]

    def some_of(self, things: Sequence[T], number: int) -> list[T]:
        """So many different ones of some things, in their order."""
        kept: list[T] = []
        for i, thing in enumerate(things):
            if self._next() * (len(things) - i) < number - len(kept):
                kept.append(thing)
        return kept


@dataclass(frozen=True)
class Size:
    """How large a network is.

    Attributes:
        steps: reactions of the route; it has a feed more than that, and as many products.
        materials: all of them, without solvents.
        reactions: all of them, side reactions included.
    """

    steps: int
    materials: int
    reactions: int

    @property
    def others(self) -> int:
        """By-products and coproducts."""
        return self.materials - 2 * self.steps - 1

    @property
    def side_reactions(self) -> int:
        """Reactions beside the route."""
        return self.reactions - self.steps


@dataclass(frozen=True)
class Step:
    """A reaction; all coefficients but that of a dimer's halves are 1.

    Attributes:
        kind: ``main``, or how it goes wrong: to an isomer of the product (at once, or from the product), by the product
            reacting on, or by a reactant with itself.
        beside: number of the main step that it competes with; its own, of a main step.
        reactants, products: coefficients.
        catalyst: what it does not run without, if anything.
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
        feeds, route: starting materials; products of the route, in its order, the last one made of all feeds.
        coproducts: what leaves, by the element that it is.
        byproducts: what side reactions make.
        isomers: by-products of the same composition as a product of the route, with that product.
        steps: main steps first.
    """

    atoms: dict[str, dict[str, int]] = field(default_factory=dict)
    feeds: list[str] = field(default_factory=list)
    route: list[str] = field(default_factory=list)
    coproducts: list[str] = field(default_factory=list)
    byproducts: list[str] = field(default_factory=list)
    isomers: dict[str, str] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)


def chosen_size(usual: Size, materials: int | None, reactions: int | None, steps: int | None) -> Size:
    """A size of which there are networks.

    Args:
        usual: what is taken for what is None, as far as it fits.
        materials, reactions, steps: what is asked for.

    Raises:
        DataError: there are none; the message says what would do.
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
    asked = ", ".join(f"{name} = {value}" for name, value in given.items() if value is not None)
    raise DataError(
        f"{asked}: there is no such network: a route of S steps has 2 S + 1 materials, and with O others besides from "
        "S or O (the larger) to S + 2 O reactions; leave one of them out, and it is chosen to fit"
    )


def _near(middle: int, low: int, high: int) -> list[int]:
    """The numbers from ``low`` to ``high``, those near ``middle`` first."""
    return sorted(range(low, high + 1), key=lambda number: (abs(number - middle), number))


def draw_network(draws: Draws, size: Size, catalysed: bool = False) -> Network:
    """A random network of that size.

    Args:
        draws: random numbers.
        size: as :func:`chosen_size` gives it.
        catalysed: whether products rearrange only where there is something that they are made of: where vessels are
            distilled, they could not be had otherwise.
    """
    made = Network()
    pairs = _route(draws, size.steps)
    # What no side reaction makes leaves as coproducts; an isomer can come of two side reactions, others of one.
    most = size.others - -(-size.side_reactions // 2)
    fewest = max(0, size.others - size.side_reactions)
    leaving = draws.whole(fewest, min(most, size.steps))
    _lay_route(made, draws, pairs, draws.some_of(range(size.steps), leaving))
    _add_byproducts(made, draws, size.others - leaving, size.side_reactions)
    if catalysed:
        made.steps = [
            replace(step, catalyst=draws.one_of(list(made.steps[step.beside].reactants)))
            if step.kind == "rearranged"
            else step
            for step in made.steps
        ]
    return made


def _route(draws: Draws, steps: int) -> list[tuple[str, str]]:
    """The two reactants of each step: feeds ``A1``, ``A2``, ... and products ``P1``, ``P2``, ..., in a tree."""
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


def _lay_route(made: Network, draws: Draws, pairs: Sequence[tuple[str, str]], leaving: Sequence[int]) -> None:
    """The materials and main steps of the route; the steps ``leaving`` have a coproduct."""
    made.feeds = sorted((name for pair in pairs for name in pair if name[0] == "A"), key=lambda name: int(name[1:]))
    made.coproducts = [f"X{i + 1}" for i in range(len(leaving))]
    left = dict(zip(leaving, made.coproducts, strict=True))
    for i, name in enumerate(made.feeds):
        made.atoms[name] = {f"Q{i + 1}": 1}
    for j, coproduct in left.items():
        carrier = draws.one_of(pairs[j])
        while carrier[0] != "A":  # what a product brings along has come with one of its feeds
            carrier = draws.one_of(pairs[int(carrier[1:]) - 1])
        made.atoms[carrier][f"Y{coproduct[1:]}"] = 1
    for j, (first, second) in enumerate(pairs):
        product = f"P{j + 1}"
        whole = {**made.atoms[first], **made.atoms[second]}
        if j in left:
            del whole[f"Y{left[j][1:]}"]
        made.atoms[product] = whole
        made.route.append(product)
        products = {product: 1, **({left[j]: 1} if j in left else {})}
        made.steps.append(Step("main", j, {first: 1, second: 1}, products))
    for name in made.coproducts:
        made.atoms[name] = {f"Y{name[1:]}": 1}


def _add_byproducts(made: Network, draws: Draws, number: int, reactions: int) -> None:
    """So many by-products of so many side reactions."""
    twice = reactions - number
    taken: set[tuple[str, str]] = set()
    for i in range(number):
        name, j = f"W{i + 1}", draws.whole(0, len(made.route) - 1)
        kind: Kind = "isomer" if i < twice else draws.one_of(("isomer", "rearranged", "overreacted", "dimer"))
        main = made.steps[j]
        partner = draws.one_of(list(main.reactants))
        key = ("dimer", partner) if kind == "dimer" else (kind, f"{made.route[j]} {partner}")
        if kind in ("dimer", "overreacted") and (key in taken or (kind == "overreacted" and partner[0] != "A")):
            kind = "isomer"
        taken.add(key)
        made.byproducts.append(name)
        for step in _gone_wrong(made, kind, j, partner, name, i < twice):
            made.steps.append(step)
        atoms: dict[str, int] = {}
        last = made.steps[-1]
        for sign, side in ((1, last.reactants), (-1, {k: n for k, n in last.products.items() if k != name})):
            for material, times in side.items():
                for element, count in made.atoms[material].items():
                    atoms[element] = atoms.get(element, 0) + sign * times * count
        made.atoms[name] = {element: count for element, count in atoms.items() if count}
        if kind in ("isomer", "rearranged"):
            made.isomers[name] = made.route[j]


def _gone_wrong(made: Network, kind: Kind, j: int, partner: str, name: str, twice: bool) -> list[Step]:
    """The side reactions that make a by-product, beside main step ``j``."""
    main, product = made.steps[j], made.route[j]
    leaving = {key: 1 for key in main.products if key != product}
    if kind == "dimer":
        return [Step(kind, j, {partner: 2}, {name: 1})]
    if kind == "overreacted":
        carries = any(f"Y{key[1:]}" in made.atoms[partner] for key in leaving)
        return [Step(kind, j, {product: 1, partner: 1}, {name: 1, **(leaving if carries else {})})]
    parallel = Step("isomer", j, dict(main.reactants), {name: 1, **leaving})
    later = Step("rearranged", j, {product: 1}, {name: 1})
    return [parallel, later] if twice else [later if kind == "rearranged" else parallel]
