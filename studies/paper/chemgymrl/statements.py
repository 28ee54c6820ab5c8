"""The paper's statements about its results, and whether ours agree: `statements.toml` and the reading of its tests.

A test compares a measure of some algorithms (`of`) with a number or another measure (`right`): ``left OPERATOR factor *
right + margin``; ``near`` allows a distance of at most ``margin``. If a measure has several values (one for each goal,
say), `only` and `without` select among them. `which` states for which of them the test has to hold: ``all``, ``any``,
or exactly the named ones. A statement agrees if all of its tests hold.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict

from chemlab.agents.evaluate.results import display_name
from chemlab.config.datafile import read_toml

from .measures import MEASURES, Values
from .results import EXPERIMENTS, Results

_OPERATORS: dict[str, Callable[[float, float, float], bool]] = {
    ">": lambda left, right, margin: left > right + margin,
    ">=": lambda left, right, margin: left >= right + margin,
    "<": lambda left, right, margin: left < right + margin,
    "<=": lambda left, right, margin: left <= right + margin,
    "near": lambda left, right, margin: abs(left - right) <= margin,
}
_FEW = 4
"""Up to this number of values are all listed."""


class _Data(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Reference(_Data):
    """Reference value of a test.

    It is the highest value of a measure (default: the left one) among some algorithms (default: the tested one) in an
    experiment (default: the statement's).
    """

    of: tuple[str, ...] = ()
    measure: str = ""
    experiment: str = ""


class Test(_Data):
    """One test; see the module's documentation.

    ``beside``: a measure to be reported with it. ``steps``: minimum length of a run for a positive result, because a
    shorter run cannot show later changes. ``same_steps``: runs of other lengths than the right side's are inconclusive.
    """

    of: tuple[str, ...]
    left: str
    operator: Literal[">", ">=", "<", "<=", "near"]
    right: float | Reference
    factor: float = 1.0
    margin: float = 0.0
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    which: Literal["all", "any"] | tuple[str, ...] = "all"
    beside: str = ""
    steps: int = 0
    same_steps: bool = False


class Claim(_Data):
    """A statement of the paper.

    It has the number of its figure, the key of the experiment, the stated value or result, the place in the paper (no
    number is read off a picture), and the meaning of agreement in words.
    """

    figure: int
    experiment: str
    says: str
    paper: str
    where: Literal["text", "caption"]
    criterion: str
    tests: tuple[Test, ...]


class Finding(NamedTuple):
    """Our result for a statement.

    It has the result in words, whether it agrees (None if results are missing or inconclusive), and variants of the
    algorithms that agree if the paper's own do not.
    """

    ours: str
    holds: bool | None
    variants: tuple[str, ...] = ()


_NOTHING = Finding("no results", None)


def load_claims() -> list[Claim]:
    """Return the paper's statements in the order of its figures."""
    content = read_toml(Path(__file__).with_name("statements.toml"))
    return [Claim.model_validate(table) for table in content["statement"]]


def compare_with_paper(results: Results) -> list[tuple[Claim, Finding]]:
    """Return the paper's statements about its results, each with our finding."""
    compared = []
    for claim in load_claims():
        labels = dict.fromkeys(label for test in claim.tests for label in test.of)
        compared.append((claim, _all_of([_algorithm(results, claim, label) for label in labels], "; ")))
    return compared


def _all_of(findings: Sequence[Finding], between: str) -> Finding:
    """Merge findings: the result holds if all hold, and fails if one fails."""
    verdicts = [finding.holds for finding in findings]
    holds = False if False in verdicts else None if None in verdicts else True
    text = between.join(finding.ours for finding in findings)
    return Finding(text, holds, tuple(v for finding in findings for v in finding.variants))


def _algorithm(results: Results, claim: Claim, label: str) -> Finding:
    """Return the finding of an algorithm of the paper, with those of its variants."""
    tests, key = [test for test in claim.tests if label in test.of], claim.experiment
    found = {
        name: _all_of([_find(results, key, test, name) for test in tests], ", ")
        for name in results.variants(key, label)
    }
    own = found.pop(label)
    others = {name: finding for name, finding in found.items() if finding.holds is not None}
    texts = [f"{display_name(name)}: {finding.ours}" for name, finding in {label: own, **others}.items()]
    agree = () if own.holds else tuple(display_name(name) for name, finding in others.items() if finding.holds)
    return Finding("; ".join(texts), own.holds, agree)


def _find(results: Results, key: str, test: Test, label: str) -> Finding:
    """Return the finding of one algorithm or variant."""
    left, right = MEASURES[test.left].find(results, key, label), _right(results, key, test, label)
    if left is None or right is None:
        return _NOTHING
    left = {name: v for name, v in left.items() if name not in test.without and (not test.only or name in test.only)}
    bounds = {name: test.factor * right.get(name, right.get("", np.nan)) for name in left}
    met = [name for name, value in left.items() if _OPERATORS[test.operator](value, bounds[name], test.margin)]
    if isinstance(test.which, tuple):
        holds: bool | None = set(met) == set(test.which)
    else:
        holds = bool(met) if test.which == "any" else len(met) == len(left)
    cell = results.cell(key, label)
    if cell is not None and holds and cell.steps < test.steps:
        holds = None
    text = _words(test, left, right, bounds, met)
    if isinstance(test.right, Reference) and test.same_steps:
        other = results.cell(test.right.experiment or key, label)
        if cell is None or other is None or cell.steps != other.steps:
            return Finding(f"{text} of other steps", None)
    if test.beside and (more := MEASURES[test.beside].find(results, key, label)) is not None:
        text += f", {test.beside} {MEASURES[test.beside].text(more[''])}"
    return Finding(text, holds)


def _right(results: Results, key: str, test: Test, label: str) -> Values | None:
    """Return the right-hand values of a test."""
    if not isinstance(test.right, Reference):
        return {"": test.right}
    find, where = MEASURES[test.right.measure or test.left].find, test.right.experiment or key
    found = [values for other in test.right.of or (label,) if (values := find(results, where, other)) is not None]
    if len(found) < len(test.right.of or (label,)):
        return None
    return {name: max(values[name] for values in found) for name in found[0]}


def _words(test: Test, left: Values, right: Values, bounds: Values, met: Sequence[str]) -> str:
    """Format the values, or for many values the number that meet the test and the smallest."""
    say = MEASURES[test.left].text
    if len(left) > _FEW:
        told = {name: value - bounds[name] for name, value in left.items()} if len(right) > 1 else left
        least = min(told, key=lambda name: told[name])
        lead = f"lead {told[least]:+.3f}" if len(right) > 1 else say(told[least])
        named = f", least {lead} ({least})" if test.which == "all" else f" ({', '.join(sorted(met)) or 'none'})"
        return f"{len(met)} of {len(left)} goals{named}"
    text = ", ".join(f"{name} {say(value)}".strip() for name, value in left.items())
    if isinstance(test.right, Reference):
        who = " and ".join(map(display_name, test.right.of)) or test.right.measure
        who = EXPERIMENTS[test.right.experiment].title if test.right.experiment else who
        text += f", {who} {MEASURES[test.right.measure or test.left].text(right[''])}"
    return text
