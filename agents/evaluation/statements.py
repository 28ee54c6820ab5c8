"""What the paper says of its results, and whether ours agree: one :class:`Statement` for each thing it says."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from chemlab.arrays import FloatArray

from .results import EXPERIMENTS, Cell, Results, display_name

__all__ = ["Statement", "compare_with_paper"]

_CLOSE = 0.9
"""Share of the scripted policy's return that the paper's "nearly match" and "come close" are read as."""
_MATCH = 0.97
"""Share that "match" is read as."""
_ZERO = 0.02
"""Returns within this of 0 are read as zero."""
_MUCH = 0.1
"""Difference of returns that "significantly" and "much" are read as; up to half of it, returns are "similar"."""
_ADDED = 0.9
"""Share of a reagent from which on it counts as added; up to the rest, as not added."""
_ALIKE = 0.8
"""Share of common actions from which on a sequence counts as the same, slightly modified."""
_SALT = ("without NaCl", "with NaCl")
_WURTZ, _FICTITIOUS, _EXT, _DIT = EXPERIMENTS

_TIE = 5e-4
"""Returns within this of each other are not told apart."""


class Finding(NamedTuple):
    """What we found."""

    text: str
    holds: bool | None
    """Whether it agrees; None where results are missing or cannot tell."""
    variants: tuple[str, ...] = ()
    """Variants that agree where the paper's own algorithm does not."""


_NOTHING = Finding("no results", None)


@dataclass(frozen=True)
class Statement:
    """Something the paper says, and what we found.

    Attributes:
        figure: number of the paper's figure it belongs to.
        says: the statement.
        paper: its number, or what it comes to.
        source: where it stands: in the text or in a figure's caption; no number is read off a picture.
        ours: what we found.
        holds: whether ours agrees by ``criterion``; None where results are missing or cannot tell.
        variants: of the algorithms: those that agree where the paper's own do not.
        criterion: what agreeing means.
    """

    figure: int
    experiment: str
    says: str
    paper: str
    source: str
    ours: str
    holds: bool | None
    variants: tuple[str, ...]
    criterion: str


@dataclass(frozen=True)
class _Claim:
    """A statement of the paper, and how to look for it in results."""

    figure: int
    key: str
    says: str
    paper: str
    source: str
    criterion: str
    find: Callable[[Results], Finding]


def compare_with_paper(results: Results) -> list[Statement]:
    """The paper's statements about its results, in the order of its figures, each beside what these results say."""
    rows = []
    for claim in _CLAIMS:
        found = claim.find(results)
        own = {name: getattr(claim, name) for name in ("figure", "says", "paper", "source", "criterion")}
        title = EXPERIMENTS[claim.key].title
        rows.append(Statement(**own, experiment=title, ours=found.text, holds=found.holds, variants=found.variants))
    return rows


# -- findings put together --------------------------------------------------------------------------------------------


def _all_of(findings: Sequence[Finding]) -> Finding:
    """Several findings as one, which holds if all of them do; one that does not is enough to say no."""
    verdicts = [finding.holds for finding in findings]
    holds = False if False in verdicts else None if None in verdicts else True
    return Finding(
        "; ".join(finding.text for finding in findings),
        holds,
        tuple(v for finding in findings for v in finding.variants),
    )


def _own(results: Results, key: str, label: str, find: Callable[[str], Finding]) -> Finding:
    """What is found of an algorithm of the paper, which decides, and beside it what is found of its variants."""
    name, own = display_name(label), find(label)
    others = [(display_name(other), find(other)) for other in results.variants(key, label) if other != label]
    texts = [f"{name}: {own.text}", *(f"{other}: {found.text}" for other, found in others if found.holds is not None)]
    agree = () if own.holds else tuple(other for other, found in others if found.holds)
    return Finding("; ".join(texts), own.holds, agree)


def _among(results: Results, key: str, labels: Iterable[str], find: Callable[[str], Finding]) -> Finding:
    """Each algorithm's finding, all of which have to hold."""
    return _all_of([_own(results, key, label, find) for label in labels])


def _each(key: str, labels: Iterable[str], find: Callable[[Cell], Finding]) -> Callable[[Results], Finding]:
    """For each algorithm what ``find`` says of its runs."""

    def found(results: Results) -> Finding:
        def one(label: str) -> Finding:
            cell = results.cell(key, label)
            return _NOTHING if cell is None else find(cell)

        return _among(results, key, labels, one)

    return found


# -- returns ----------------------------------------------------------------------------------------------------------


def _played(results: Results, key: str, policy: str) -> float | None:
    """Mean return of a policy that learns nothing."""
    traced = results.trace(key, policy)
    return None if traced is None else float(traced["mean_return"])


def _heuristic(results: Results, key: str) -> float | None:
    known = [value for cell in results.cells[key].values() if (value := cell.heuristic_mean()) is not None]
    return float(np.mean(known)) if known else _played(results, key, "heuristic")


def _near(value: float | None, paper: float, tolerance: float = 0.02) -> Finding:
    return _NOTHING if value is None else Finding(f"{value:.3f}", abs(value - paper) <= tolerance)


def _least(ratios: Mapping[str, float]) -> Finding:
    goal = min(ratios, key=lambda name: ratios[name])
    reached = sum(value >= _MATCH for value in ratios.values())
    text = f"{reached} of {len(ratios)} goals at {_MATCH:g} or more, least {ratios[goal]:.3f} ({goal})"
    return Finding(text, reached == len(ratios))


def _reached(ratios: Mapping[str, float], expected: Callable[[set[str]], bool]) -> Finding:
    goals = {goal for goal, value in ratios.items() if value >= _CLOSE}
    text = f"{len(goals)} of {len(ratios)} goals ({', '.join(sorted(goals)) or 'none'})"
    return Finding(text, expected(goals))


def _few(cell: Cell) -> Finding:
    """Goals but NaCl, which comes with every other, that any run comes close on."""
    goals = [goal for goal in cell.goals if goal != "NaCl" and (cell.relative(goal) >= _CLOSE).any()]
    return Finding(f"{len(goals)} goals but NaCl ({', '.join(goals) or 'none'})", bool(goals))


def _every_run(cell: Cell, goal: str) -> Finding:
    least = float(cell.relative(goal).min())
    return Finding(f"{least:.3f} or more", least >= _CLOSE)


def _above_for_all(key: str, label: str, others: Sequence[str]) -> Callable[[Results], Finding]:
    """Whether an algorithm's mean over runs is above that of every other for each goal."""

    def found(results: Results) -> Finding:
        rivals = [cell for other in others if (cell := results.cell(key, other)) is not None]
        if len(rivals) < len(others):
            return _NOTHING

        def one(cell: Cell) -> Finding:
            ours = cell.mean_ratios()
            leads = {goal: ours[goal] - max(rival.mean_ratios()[goal] for rival in rivals) for goal in ours}
            goal = min(leads, key=lambda name: leads[name])
            return Finding(f"least lead {leads[goal]:+.3f} ({goal})", leads[goal] > _TIE)

        return _each(key, (label,), one)(results)

    return found


def _both(results: Results) -> Finding:
    """Which algorithms' best runs make both E and I: PPO's, and no other."""
    done = {}
    for label in EXPERIMENTS[_FICTITIOUS].algorithms:
        cell = results.cell(_FICTITIOUS, label)
        if cell is None:
            return _NOTHING
        done[display_name(label)] = min(cell.best_ratios()[goal] for goal in ("E", "I")) >= _CLOSE
    names = [name for name, both in done.items() if both]
    return Finding(", ".join(names) or "none", names == ["PPO"])


def _end(cell: Cell) -> float | None:
    """Mean training return at the end."""
    finals = cell.final_training_returns()
    return float(finals.mean()) if len(finals) else None


def _training_end(cell: Cell, holds: Callable[[float], bool]) -> Finding:
    end = _end(cell)
    return _NOTHING if end is None else Finding(f"{end:.3f}", holds(end))


def _over_random(labels: Iterable[str], holds: Callable[[float], bool]) -> Callable[[Results], Finding]:
    """Training returns at the end on Wurtz RxN less what random actions come to."""

    def found(results: Results) -> Finding:
        random = _played(results, _WURTZ, "random")
        if random is None:
            return _NOTHING

        def one(cell: Cell) -> Finding:
            end = _end(cell)
            return _NOTHING if end is None else Finding(f"{end - random:+.3f}", holds(end - random))

        return _each(_WURTZ, labels, one)(results)

    return found


def _gain(cell: Cell, at_least: float) -> Finding:
    reference = cell.heuristic_mean()
    if reference is None:
        return _NOTHING
    gains = cell.means() - reference
    return Finding(f"{gains.mean():+.3f} (best run {gains.max():+.3f})", bool(gains.mean() >= at_least))


def _gap(results: Results, label: str) -> Finding:
    """How much of the scripted policy's return there is in the two reaction experiments."""
    shares, steps = [], set()
    for key in (_FICTITIOUS, _WURTZ):
        cell = results.cell(key, label)
        reference = None if cell is None else cell.heuristic_mean()
        if cell is None or reference is None:
            return _NOTHING
        shares.append(float(cell.means().mean()) / reference)
        steps.add(cell.steps)
    text = f"{shares[0]:.2f}, Wurtz RxN {shares[1]:.2f}"
    if len(steps) > 1:
        return Finding(f"{text} of other steps", None)
    return Finding(text, shares[0] > shares[1])


def _positive(cell: Cell, each: bool) -> Finding:
    """Whether training ends above zero, on average or in each run."""
    ends = cell.final_training_returns()
    if not len(ends):
        return _NOTHING
    text = f"{ends.mean():.3f}" + (f" (lowest run {ends.min():.3f})" if each else "")
    return Finding(text, bool((ends.min() if each else ends.mean()) > _ZERO))


def _at_zero(cell: Cell) -> Finding:
    mean = float(cell.means().mean())
    return Finding(f"{mean:.3f}", abs(mean) <= _ZERO)


def _spread(results: Results) -> Finding:
    """Whether PPO's runs on DiT end further from each other than DQN's."""
    cells = [results.cell(_DIT, label) for label in ("ppo", "dqn")]
    ends = [cell.final_training_returns() for cell in cells if cell is not None and len(cell.runs) > 1]
    if len(ends) < 2 or min(map(len, ends)) < 2:
        return _NOTHING
    ours, theirs = (float(some.std(ddof=1)) for some in ends)
    return Finding(f"standard deviation of runs: PPO {ours:.3f}, DQN {theirs:.3f}", ours > theirs)


def _all_above(key: str, labels: Iterable[str], others: Sequence[str]) -> Callable[[Results], Finding]:
    """Whether every run of some algorithms is better than every run of others."""

    def compared(results: Results) -> Finding:
        rivals = [cell for label in others if (cell := results.cell(key, label)) is not None]
        if len(rivals) < len(others):
            return _NOTHING
        highest = max(float(cell.means().max()) for cell in rivals)

        def one(cell: Cell) -> Finding:
            least = float(cell.means().min())
            return Finding(f"{least:.3f} or more", least > highest)

        found = _each(key, labels, one)(results)
        return found._replace(text=f"{found.text}; {' and '.join(map(display_name, others))}: {highest:.3f} or less")

    return compared


def _highest(key: str, label: str, of: Callable[[Cell], float]) -> Callable[[Results], Finding]:
    """Whether a number is highest for one of the paper's algorithms."""

    def found(results: Results) -> Finding:
        cells = {name: results.cell(key, name) for name in EXPERIMENTS[key].algorithms}
        values = {name: of(cell) for name, cell in cells.items() if cell is not None}
        if len(values) < len(cells):
            return _NOTHING
        others = max(value for name, value in values.items() if name != label)
        return Finding(
            f"{display_name(label)}: {values[label]:.3f}, others {others:.3f} or less", values[label] - others > _TIE
        )

    return found


def _mean(cell: Cell) -> float:
    return float(cell.means().mean())


def _best(cell: Cell) -> float:
    return cell.best.result.mean


def _versus(
    key: str, labels: Iterable[str], other: str, of: Callable[[Cell], float | None], holds: Callable[[float], bool]
) -> Callable[[Results], Finding]:
    """A number of some algorithms beside another's: ``holds`` of the differences."""

    def compared(results: Results) -> Finding:
        rival = results.cell(key, other)
        theirs = None if rival is None else of(rival)
        if theirs is None:
            return _NOTHING

        def one(cell: Cell) -> Finding:
            ours = of(cell)
            return _NOTHING if ours is None else Finding(f"{ours:.3f}", holds(ours - theirs))

        found = _each(key, labels, one)(results)
        return found._replace(text=f"{found.text}; {display_name(other)}: {theirs:.3f}")

    return compared


# -- convergence ------------------------------------------------------------------------------------------------------


def _convergence(cell: Cell) -> tuple[int, bool] | None:
    """The step from which on the mean over runs of the evaluations stays near the last one's, and whether that is the
    last itself. Near: within a twentieth of the scripted policy's mean, for good and bad algorithms alike.

    Evaluations have every goal equally often. In training, chance alone moves the mean by more than that, since
    returns differ most by goal.
    """
    runs, reference = [run.run.evaluations() for run in cell.runs], cell.heuristic_mean()
    count = min(len(run) for run in runs)
    if count < 2 or reference is None:
        return None
    mean = np.mean([[evaluation.mean for evaluation in run[:count]] for run in runs], axis=0)
    away = np.flatnonzero(np.abs(mean - mean[-1]) > 0.05 * reference)
    first = 0 if not len(away) else int(away[-1]) + 1
    return runs[0][first].step, first == count - 1


def _converged(cell: Cell) -> Finding:
    found = _convergence(cell)
    if found is None:
        return _NOTHING
    step, at_end = found
    # Runs that end soon after cannot show that nothing comes later, but they can show that something did.
    holds = False if step >= 300_000 or at_end else True if cell.steps >= 600_000 else None
    return Finding(f"by {step / 1000:.0f}k of {cell.steps / 1000:.0f}k steps", holds)


def _slower(results: Results) -> Finding:
    """Whether the others take at least twice PPO's steps on fictitious RxN."""
    cell = results.cell(_FICTITIOUS, "ppo")
    quick = None if cell is None else _convergence(cell)
    if quick is None:
        return _NOTHING

    def one(other: Cell) -> Finding:
        found = _convergence(other)
        if found is None:
            return _NOTHING
        return Finding(f"by {found[0] / 1000:.0f}k of {other.steps / 1000:.0f}k steps", found[0] >= 2 * quick[0])

    others = _each(_FICTITIOUS, ("a2c", "sac", "td3"), one)(results)
    return others._replace(text=f"PPO: by {quick[0] / 1000:.0f}k steps; {others.text}")


# -- what policies do -------------------------------------------------------------------------------------------------


def _added(results: Results, label: str, goal: str) -> dict[str, FloatArray] | None:
    """By reagent the share of it that has been added after each step: actions add shares of what is left."""
    traced = results.trace(_FICTITIOUS, label)
    if traced is None or results.traces is None:
        return None
    names = results.traces["experiments"][_FICTITIOUS]["action_names"]
    actions: FloatArray = np.array(traced["by_goal"][goal]["mean_actions"], dtype=np.float64)
    return {
        name.removeprefix("add "): np.subtract(1.0, np.cumprod(1.0 - actions[:, column]))
        for column, name in enumerate(names)
        if name.startswith("add ")
    }


def _adds(expected: Callable[[Mapping[str, float]], bool]) -> Callable[[Results, str], Finding]:
    """What is added for goal E in the whole episode."""

    def found(results: Results, label: str) -> Finding:
        added = _added(results, label, "E")
        if added is None:
            return _NOTHING
        shares = {name: float(after[-1]) for name, after in added.items()}
        return Finding(", ".join(f"{name} {share:.2f}" for name, share in shares.items()), expected(shares))

    return found


def _three(shares: Mapping[str, float]) -> bool:
    return all(shares[name] >= _ADDED for name in "ABC")


def _staggered(results: Results, label: str) -> Finding:
    """Whether for goal I one of A, B and C comes at least two steps after the others and D."""
    added = _added(results, label, "I")
    if added is None:
        return _NOTHING
    steps = {name: _first_at(after, _ADDED) for name, after in added.items()}
    first, second, third = sorted(steps[name] for name in "ABC")
    text = ", ".join(f"{name} {'never' if np.isinf(step) else f'step {step:.0f}'}" for name, step in steps.items())
    return Finding(text, bool(np.isfinite(third) and third - max(first, second, steps["D"]) >= 2))


def _first_at(values: FloatArray, least: float) -> float:
    """Number of the first step, from 1, with at least that; infinite where there is none."""
    where = np.flatnonzero(values >= least)
    return float(where[0] + 1) if len(where) else np.inf


def _doing(key: str, labels: Iterable[str], find: Callable[[Results, str], Finding]) -> Callable[[Results], Finding]:
    return lambda results: _among(results, key, labels, lambda label: find(results, label))


def _best_actions(results: Results, key: str, label: str, case: str) -> list[str] | None:
    """The best sequence for dodecane, in words."""
    traced = results.trace(key, label)
    entry = None if traced is None else traced["by_goal"]["dodecane"]["by_case"].get(case)
    if entry is None or results.traces is None:
        return None
    names = results.traces["experiments"][key]["action_names"]
    return [names[action] for action in entry["best"]["actions"]]


def _ends(key: str, case: str, expected: Mapping[str, bool]) -> Callable[[Results], Finding]:
    """Whether the best sequence for dodecane ends the experiment itself."""

    def found(results: Results) -> Finding:
        def one(name: str, wanted: bool) -> Finding:
            actions = _best_actions(results, key, name, case)
            if actions is None:
                return _NOTHING
            ends = actions[-1].startswith("end")
            return Finding("ends it" if ends else "runs to the limit", ends == wanted)

        return _all_of([_own(results, key, label, partial(one, wanted=wanted)) for label, wanted in expected.items()])

    return found


def _same_with_salt(results: Results) -> Finding:
    """How much of the best sequences with and without salt is the same."""

    def one(name: str, least: float) -> Finding:
        plain, salted = (_best_actions(results, _DIT, name, case) for case in _SALT)
        if plain is None or salted is None:
            return _NOTHING
        share = difflib.SequenceMatcher(None, plain, salted, autojunk=False).ratio()
        return Finding(f"{share:.2f} in common", share >= least)

    wanted = {"a2c": _ALIKE, "dqn": 1.0}
    return _all_of([_own(results, _DIT, label, partial(one, least=least)) for label, least in wanted.items()])


def _case_ratio(results: Results, label: str, case: str) -> float | None:
    """Return over the scripted policy's in one case, over the goals that meet both."""
    ours, reference = results.trace(_DIT, label), results.trace(_DIT, "heuristic")
    if ours is None or reference is None:
        return None
    pairs = [
        (goal["by_case"][case]["mean_return"], reference["by_goal"][name]["by_case"][case]["mean_return"])
        for name, goal in ours["by_goal"].items()
        if set(_SALT) <= goal["by_case"].keys()
    ]
    return sum(a for a, _ in pairs) / sum(b for _, b in pairs) if pairs else None


def _cases(expected: Callable[[float, float], bool]) -> Callable[[Results, str], Finding]:
    def found(results: Results, label: str) -> Finding:
        without, salted = (_case_ratio(results, label, case) for case in _SALT)
        if without is None or salted is None:
            return _NOTHING
        return Finding(f"{without:.3f} without, {salted:.3f} with salt", expected(without, salted))

    return found


# -- what the paper says ----------------------------------------------------------------------------------------------

_CLAIMS: tuple[_Claim, ...] = (
    _Claim(
        *(5, _WURTZ, "heuristic, mean return", "about 0.62", "text", "within 0.02"),
        lambda results: _near(_heuristic(results, _WURTZ), 0.62),
    ),
    _Claim(
        *(5, _WURTZ, "PPO matches the heuristic for all targets (best run)", "7 of 7", "text"),
        f"at least {_MATCH:g} x heuristic for every goal",
        _each(_WURTZ, ("ppo",), lambda cell: _least(cell.best_ratios())),
    ),
    _Claim(
        *(5, _WURTZ, "PPO matches the heuristic for all targets (mean of runs)", "7 of 7", "text"),
        f"at least {_MATCH:g} x heuristic for every goal",
        _each(_WURTZ, ("ppo",), lambda cell: _least(cell.mean_ratios())),
    ),
    _Claim(
        *(5, _WURTZ, "some SAC and TD3 agents come close on a few targets", "a few", "text"),
        f"any run at {_CLOSE:g} x heuristic or more for a goal but NaCl",
        _each(_WURTZ, ("sac", "td3"), _few),
    ),
    _Claim(
        *(5, _WURTZ, "each algorithm consistently produces NaCl", "all", "text"),
        f"every run at {_CLOSE:g} x heuristic or more",
        _each(_WURTZ, EXPERIMENTS[_WURTZ].algorithms, lambda cell: _every_run(cell, "NaCl")),
    ),
    _Claim(
        *(5, _WURTZ, "PPO outperforms A2C, SAC and TD3 for all 7 targets", "above", "caption"),
        "mean over runs, as a share of the heuristic's",
        _above_for_all(_WURTZ, "ppo", ("a2c", "sac", "td3")),
    ),
    _Claim(
        *(5, _WURTZ, "A2C comes close to the heuristic only for NaCl", "NaCl only", "text"),
        f"best run: NaCl alone at {_CLOSE:g} x heuristic or more",
        _each(_WURTZ, ("a2c",), lambda cell: _reached(cell.best_ratios(), lambda goals: goals == {"NaCl"})),
    ),
    _Claim(
        *(6, _WURTZ, "random actions, mean return", "about 0.44", "text", "within 0.02"),
        lambda results: _near(_played(results, _WURTZ, "random"), 0.44),
    ),
    _Claim(
        *(6, _WURTZ, "agents of each algorithm achieve a return of at least 0.4", "0.4 or more", "text"),
        "mean training return at the end",
        _each(_WURTZ, EXPERIMENTS[_WURTZ].algorithms, lambda cell: _training_end(cell, lambda end: end >= 0.4)),
    ),
    _Claim(
        *(6, _WURTZ, "A2C, SAC and TD3 are not much better than random actions", "about 0", "text"),
        f"mean training return at the end at most {_MUCH:g} above",
        _over_random(("a2c", "sac", "td3"), lambda gain: gain <= _MUCH),
    ),
    _Claim(
        *(6, _WURTZ, "PPO is significantly better than random actions", "above 0", "text"),
        f"mean training return at the end more than {_MUCH:g} above",
        _over_random(("ppo",), lambda gain: gain > _MUCH),
    ),
    _Claim(
        *(6, _WURTZ, "the best SAC and TD3 agents outperform the best A2C agent", "above", "text", "best run above"),
        _versus(_WURTZ, ("sac", "td3"), "a2c", _best, lambda difference: difference > _TIE),
    ),
    _Claim(
        *(6, _WURTZ, "each algorithm converges before 300k steps", "before 300k", "caption"),
        "mean of evaluations (ten in a run) within 5 % of the heuristic's return of the last one from then on",
        _each(_WURTZ, EXPERIMENTS[_WURTZ].algorithms, _converged),
    ),
    _Claim(
        *(7, _FICTITIOUS, "heuristic, mean return", "about 0.83", "text", "within 0.02"),
        lambda results: _near(_heuristic(results, _FICTITIOUS), 0.83),
    ),
    _Claim(
        *(7, _FICTITIOUS, "PPO consistently matches the heuristic (mean of runs)", "5 of 5", "text"),
        f"at least {_MATCH:g} x heuristic for every goal",
        _each(_FICTITIOUS, ("ppo",), lambda cell: _least(cell.mean_ratios())),
    ),
    _Claim(
        *(7, _FICTITIOUS, "the best A2C and SAC nearly match the heuristic for all products but I", "all but I"),
        *("text", f"best run: E, F, G, H and not I at {_CLOSE:g} x heuristic or more"),
        _each(_FICTITIOUS, ("a2c", "sac"), lambda cell: _reached(cell.best_ratios(), lambda g: g == set("EFGH"))),
    ),
    _Claim(
        *(7, _FICTITIOUS, "the best TD3 nearly matches the heuristic for all products but E", "all but E"),
        *("text", f"best run: F, G, H, I and not E at {_CLOSE:g} x heuristic or more"),
        _each(_FICTITIOUS, ("td3",), lambda cell: _reached(cell.best_ratios(), lambda goals: goals == set("FGHI"))),
    ),
    _Claim(
        *(7, _FICTITIOUS, "PPO outperforms A2C, SAC and TD3 for all 5 targets", "above", "caption"),
        "mean over runs, as a share of the heuristic's",
        _above_for_all(_FICTITIOUS, "ppo", ("a2c", "sac", "td3")),
    ),
    _Claim(
        *(8, _FICTITIOUS, "PPO converges quickly, the others take much longer", "longer", "caption"),
        "mean of evaluations (ten in a run) within 5 % of the heuristic's return of the last one from then on: at "
        "least twice PPO's steps",
        _slower,
    ),
    _Claim(
        *(8, _FICTITIOUS, "A2C, SAC and TD3 are nearer to the optimum than on Wurtz RxN", "nearer", "caption"),
        "mean over runs, as a share of the heuristic's, above that on Wurtz RxN",
        _doing(_FICTITIOUS, ("a2c", "sac", "td3"), _gap),
    ),
    _Claim(
        *(9, _FICTITIOUS, "for E the best A2C, PPO and SAC add A, B and C, and not D", "A, B, C", "text"),
        f"share added in the episode: A, B and C at least {_ADDED:g}, D at most {1.0 - _ADDED:.1g}",
        _doing(
            _FICTITIOUS,
            ("a2c", "ppo", "sac"),
            _adds(lambda shares: _three(shares) and shares["D"] <= 1.0 - _ADDED),
        ),
    ),
    _Claim(
        *(9, _FICTITIOUS, "for E the best TD3 adds D as well", "A, B, C, D", "text"),
        f"share added in the episode: all at least {_ADDED:g}",
        _doing(_FICTITIOUS, ("td3",), _adds(lambda shares: _three(shares) and shares["D"] >= _ADDED)),
    ),
    _Claim(
        *(9, _FICTITIOUS, "for I the best of each add D and two of A, B, C, and the third several steps later"),
        *("later", "text", f"{_ADDED:g} of the third added at least 2 steps after {_ADDED:g} of the others"),
        _doing(_FICTITIOUS, EXPERIMENTS[_FICTITIOUS].algorithms, _staggered),
    ),
    _Claim(
        *(9, _FICTITIOUS, "PPO alone succeeds with both E and I", "PPO", "text"),
        f"best run: both at {_CLOSE:g} x heuristic or more",
        _both,
    ),
    _Claim(
        *(10, _EXT, "the best PPO-XL policies exceed the heuristic, on average", "about +0.1", "text"),
        "best policies' mean over runs at least 0.05 above (the best run's mean over episodes is beside it)",
        _each(_EXT, ("ppo-xl",), lambda cell: _gain(cell, 0.05)),
    ),
    _Claim(
        *(10, _EXT, "PPO outperforms the heuristic", "above 0", "text", "best policies' mean over runs above"),
        _each(_EXT, ("ppo",), lambda cell: _gain(cell, 0.0)),
    ),
    _Claim(
        *(10, _EXT, "PPO and PPO-XL consistently outperform the other algorithms", "above", "text"),
        "best policies: lowest run above the others' highest",
        _all_above(_EXT, ("ppo-xl", "ppo"), ("a2c", "dqn")),
    ),
    _Claim(
        *(10, _EXT, "A2C does not achieve a return above zero", "0", "text"),
        f"mean training return at the end at most {_ZERO:g}",
        _each(_EXT, ("a2c",), lambda cell: _training_end(cell, lambda end: end <= _ZERO)),
    ),
    _Claim(
        *(10, _EXT, "A2C's policies are worth as much as ending the experiment at once", "0", "caption"),
        f"best policies' mean over runs within {_ZERO:g} of 0",
        _each(_EXT, ("a2c",), _at_zero),
    ),
    _Claim(
        *(10, _EXT, "PPO and PPO-XL consistently acquire positive returns", "above 0", "caption"),
        f"training return at the end above {_ZERO:g} in every run",
        _each(_EXT, ("ppo-xl", "ppo"), lambda cell: _positive(cell, each=True)),
    ),
    _Claim(
        *(10, _EXT, "DQN ends with a negative return", "below 0", "text", "mean training return at the end below 0"),
        _each(_EXT, ("dqn",), lambda cell: _training_end(cell, lambda end: end < 0.0)),
    ),
    _Claim(
        *(11, _EXT, "PPO and PPO-XL end the experiment themselves, A2C and DQN do not", "ends / does not"),
        *("text", "last action of the best sequence, goal dodecane"),
        _ends(_EXT, "", {"ppo-xl": True, "ppo": True, "a2c": False, "dqn": False}),
    ),
    _Claim(
        *(12, _DIT, "DQN, PPO and PPO-XL consistently acquire positive returns", "above 0", "caption"),
        f"training return at the end above {_ZERO:g} in every run",
        _each(_DIT, ("dqn", "ppo", "ppo-xl"), lambda cell: _positive(cell, each=True)),
    ),
    _Claim(
        *(12, _DIT, "A2C gets positive returns on average", "above 0", "caption"),
        f"mean training return at the end above {_ZERO:g}",
        _each(_DIT, ("a2c",), lambda cell: _positive(cell, each=False)),
    ),
    _Claim(
        *(12, _DIT, "DQN and PPO acquire similar returns on average", "similar", "caption"),
        f"mean training returns at the end within {_MUCH:g}",
        _versus(_DIT, ("ppo",), "dqn", _end, lambda difference: abs(difference) <= _MUCH),
    ),
    _Claim(
        *(12, _DIT, "PPO's runs vary more than DQN's", "more", "caption", "training returns at the end"),
        _spread,
    ),
    _Claim(
        *(12, _DIT, "the best PPO policy outperforms the best DQN policy", "above", "caption", "best run above"),
        _versus(_DIT, ("ppo",), "dqn", _best, lambda difference: difference > _TIE),
    ),
    _Claim(
        *(12, _DIT, "PPO-XL outperforms the others on average", "highest", "caption", "mean over runs highest"),
        _highest(_DIT, "ppo-xl", _mean),
    ),
    _Claim(
        *(12, _DIT, "PPO-XL outperforms the others in the best case", "highest", "caption", "best run highest"),
        _highest(_DIT, "ppo-xl", _best),
    ),
    _Claim(
        *(13, _DIT, "PPO and PPO-XL achieve the optimal return with and without salt, by one agent", "1 and 1"),
        *("text", f"best run at least {_MATCH:g} x heuristic in both cases"),
        _doing(_DIT, ("ppo-xl", "ppo"), _cases(lambda without, salted: min(without, salted) >= _MATCH)),
    ),
    _Claim(
        *(13, _DIT, "without salt the best A2C and DQN do as the heuristic does, with salt they do not", "1 and less"),
        *("text", f"best run at least {_CLOSE:g} x heuristic without salt and less with it"),
        _doing(_DIT, ("a2c", "dqn"), _cases(lambda without, salted: without >= _CLOSE > salted)),
    ),
    _Claim(
        *(13, _DIT, "with salt A2C only slightly modifies its actions, and DQN not at all", "same", "text"),
        f"best sequences for dodecane: DQN's the same, A2C's with {_ALIKE:g} or more in common",
        _same_with_salt,
    ),
    _Claim(
        *(13, _DIT, "without salt, all but DQN end the experiment themselves", "ends / does not", "text"),
        "last action of the best sequence, goal dodecane",
        _ends(_DIT, _SALT[0], {"ppo-xl": True, "ppo": True, "a2c": True, "dqn": False}),
    ),
)
