"""What an experiment is worth: the paper's worked example, ions and salts, penalties; and what policies earn."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import mapping, play_experiments

from chemlab.agents.policies import scripted_bench
from chemlab.agents.random_policy import RandomPolicy
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.role_env import RoleEnv
from chemlab.lab.experiments import ExperimentBatch
from chemlab.physics.backends import most_steps
from chemlab.roles.operation_bench import OperationBench


def arena_for(bench: str, goal: str, scenario: str | Scenario = "wurtz_dodecane", members: int = 1) -> ExperimentBatch:
    """A running experiment of each member, on its paper's starting state."""
    batch = ExperimentBatch(scenario, bench, members)
    for member in batch.members:
        batch.seed(int(member), int(member))
    batch.reset(batch.members, batch.scenario.goals.index(goal))
    return batch


def measured(batch: ExperimentBatch, *vessels: dict[str, float]) -> float:
    """The bench's measure (what a score is the change of) with these amounts in its vessels."""
    batch.shelf.amounts[0] = 0.0
    for position, contents in enumerate(vessels):
        for name, mol in contents.items():
            batch.shelf.amounts[0, position, batch.shelf.layout.index(name)] = mol
    return float(batch.bench.measure(batch.shelf, batch.experiments, batch.members)[0])


def test_the_papers_worked_example() -> None:
    """1 mol each of dodecane and NaCl, parted 0.7 : 0.2 and 0.3 : 0.8: purity from 1/3 to 0.4928, reward 0.1595."""
    batch = arena_for("ext", "dodecane")
    start = measured(batch, {"diethyl_ether": 4.0, "dodecane": 1.0, "Na+": 1.0, "Cl-": 1.0})
    assert start == pytest.approx(1.0 / 3.0, rel=1e-14)
    end = measured(
        batch,
        {"diethyl_ether": 4.0, "dodecane": 0.7, "Na+": 0.2, "Cl-": 0.2},
        {"water": 20.0, "dodecane": 0.3, "Na+": 0.8, "Cl-": 0.8},
    )
    assert end == pytest.approx(0.7 * 7.0 / 11.0 + 0.3 * 3.0 / 19.0, rel=1e-14)
    assert end == pytest.approx(0.4928, abs=5e-5)
    # The bench's own start has its salt partly undissolved; that must not matter.
    reward = float(batch.finish(batch.members)[0])
    assert reward == pytest.approx(end - 1.0 / 3.0, rel=1e-12)
    assert reward == pytest.approx(0.1595, abs=5e-5)


def test_solute_purity_does_not_change_as_salt_precipitates() -> None:
    """Undissolved salt counts as its two ions; solvents do not count; metal counts as one."""
    batch = arena_for("ext", "dodecane")
    dissolved = measured(batch, {"diethyl_ether": 4.0, "dodecane": 1.0, "Na+": 0.5, "Cl-": 0.5})
    solid = measured(batch, {"dodecane": 1.0, "NaCl": 0.3, "Na+": 0.2, "Cl-": 0.2, "water": 9.0})
    assert dissolved == solid == pytest.approx(0.5, rel=1e-14)
    assert measured(batch, {"dodecane": 1.0, "Na": 0.25, "NaOH": 0.5}) == pytest.approx(1.0 / 2.25, rel=1e-14)


def test_dissolved_salt_counts_as_salt_where_salt_is_the_goal() -> None:
    """Goal NaCl: 0.2 mol solid and 0.4 mol of each ion are 0.6 mol of salt; a pair of ions counts as one in purity."""
    batch = arena_for("ext", "NaCl")
    found = measured(batch, {"water": 5.0, "NaCl": 0.2, "Na+": 0.4, "Cl-": 0.4, "dodecane": 0.3})
    assert found == pytest.approx(0.6 * 0.6 / 0.9, rel=1e-14)
    spread = measured(batch, {"NaCl": 0.5, "dodecane": 1.0}, {"water": 5.0, "Na+": 0.5, "Cl-": 0.5})
    assert spread == pytest.approx(0.5 * (0.5 / 1.5) + 0.5 * 1.0, rel=1e-14)
    # Only pairs: of 0.5 mol Na+, 0.2 mol Cl-, 0.3 mol OH- 0.2 mol are the goal, of purity 0.2 / 0.5.
    found = measured(batch, {"water": 5.0, "Na+": 0.5, "Cl-": 0.2, "OH-": 0.3})
    assert found == pytest.approx(0.2 * 0.2 / 0.5, rel=1e-14)


def test_absolute_purity_counts_everything() -> None:
    """On the distillation bench solvents count, too; a pair of ions counts as one, dissolved or not."""
    batch = arena_for("dit", "dodecane")
    found = measured(batch, {"dodecane": 0.5, "diethyl_ether": 1.0, "Na+": 0.2, "Cl-": 0.2})
    assert found == pytest.approx(0.5 * 0.5 / 1.7, rel=1e-14)
    assert measured(batch, {"dodecane": 0.5, "diethyl_ether": 1.0, "NaCl": 0.2}) == pytest.approx(found, rel=1e-14)
    assert measured(batch, {"dodecane": 0.4}, {"dodecane": 0.6, "water": 0.6}) == pytest.approx(0.4 + 0.3, rel=1e-14)
    salt = arena_for("dit", "NaCl")
    assert measured(salt, {"NaCl": 0.2, "Na+": 0.4, "Cl-": 0.4, "water": 0.6}) == pytest.approx(0.6 * 0.5, rel=1e-14)


def test_a_salt_counts_in_purity_among_as_much_dissolved_as_not() -> None:
    """Of 0.5 mol of salt and 0.3 mol of dodecane, whatever else is there; never more than 1."""
    among = {"NaCl": {"purity_among": ["NaCl", "dodecane"]}}
    batch = arena_for("ext", "NaCl", load_scenario({**mapping("wurtz_dodecane"), "specifications": among}))
    for solid, ions in ((0.5, 0.0), (0.1, 0.4)):
        measured(batch, {"water": 20.0, "NaCl": solid, "Na+": ions, "Cl-": ions, "dodecane": 0.3})
        found = batch.bench.best(batch.shelf, batch.experiments, batch.members)
        assert found[0] == pytest.approx([0.5, 0.5 / 0.8], rel=1e-14)


@pytest.mark.parametrize("grades", [{}, {"pure": {"purity_at_least": 1.0}}])
@pytest.mark.parametrize("bench", ["ext", "dit"])
def test_lost_product_counts_against_the_agent(bench: str, grades: dict[str, Any]) -> None:
    """With everything gone the measure is 0, so the score is minus what there was at the start, whatever was asked."""
    batch = arena_for(bench, "dodecane", load_scenario({**mapping("wurtz_dodecane"), "grades": grades}))
    start = float(batch.bench.measure(batch.shelf, batch.experiments, batch.members)[0])
    assert start > 0.1
    assert measured(batch) == 0.0
    assert float(batch.finish(batch.members)[0]) == pytest.approx(-start, rel=1e-14)


def test_reaction_score_is_what_was_produced() -> None:
    """Product that was in the vessel before does not count; dissolved salt does where salt is the goal."""
    batch = ExperimentBatch("wurtz_dodecane", "rxn")
    for goal, brought in (("dodecane", {"dodecane": 0.3}), ("NaCl", {"NaCl": 0.2, "Na+": 0.1, "Cl-": 0.1})):
        batch.seed(0, 0)
        batch.reset(batch.members, batch.scenario.goals.index(goal))
        batch.shelf.fill(0, 0, 1.2, {"diethyl_ether": 4.0, **brought})
        batch.bench.begin(batch.shelf, batch.experiments, batch.members)
        after = float(batch.bench.measure(batch.shelf, batch.experiments, batch.members)[0])
        assert after == pytest.approx(0.3, rel=1e-9)
        batch.shelf.amounts[0, 0, batch.shelf.layout.index(goal)] += 0.25
        assert float(batch.finish(batch.members)[0]) == pytest.approx(0.25, rel=1e-9)


@pytest.mark.parametrize(("goal", "score"), [("E", 0.2), ("F", 0.5 - 0.2), ("G", 0.1 - 0.2), ("I", 0.05 - 0.2)])
def test_fictitious_penalty(goal: str, score: float) -> None:
    """Moles of E come off the score unless E is the goal; other by-products cost nothing."""
    batch = arena_for("rxn", goal, "fictitious")
    made = {"diethyl_ether": 4.0, "E": 0.2, "F": 0.5, "G": 0.1, "H": 0.3, "I": 0.05, "A": 0.4}
    assert measured(batch, made) == pytest.approx(score, rel=1e-14)
    assert float(batch.finish(batch.members)[0]) == pytest.approx(score, rel=1e-14)


def means(bench: str, scenario: str, episodes: int, policy: str) -> dict[str, float]:
    """Mean score for each goal on the paper's starting states."""
    found = {}
    for i, goal in enumerate(ExperimentBatch(scenario, bench).scenario.goals):
        batch = arena_for(bench, goal, scenario, episodes)
        shape = batch.bench.action_space.shape
        size = shape[0] if shape else 0
        player = scripted_bench(batch.bench) if policy == "scripted" else RandomPolicy(size, i)
        found[goal] = float(play_experiments(batch, player).mean())
    return found


def test_returns_of_reactions_are_the_papers() -> None:
    """Over seven Wurtz goals scripted 0.62 +- 0.02 and random 0.44 +- 0.03, over five fictitious ones scripted 0.83
    +- 0.03 (100 episodes each): E, F, G, H are near their limit of 1, I is hard."""
    found = {}
    for scenario in ("wurtz_dodecane", "fictitious"):
        scripted, random = (means("rxn", scenario, 100, policy) for policy in ("scripted", "random"))
        assert all(scripted[goal] > random[goal] for goal in scripted)
        found[scenario] = np.mean(list(scripted.values())), np.mean(list(random.values()))
    assert found["wurtz_dodecane"] == (pytest.approx(0.62, abs=0.02), pytest.approx(0.44, abs=0.03))
    assert found["fictitious"][0] == pytest.approx(0.83, abs=0.03)
    assert min(scripted[goal] for goal in "EFGH") > 0.8
    assert scripted["I"] < 0.5


@pytest.mark.parametrize("scenario", ["wurtz_dodecane", "salt_from_oil"])
def test_extraction_heuristic_gains_on_every_goal(scenario: str) -> None:
    """Washing earns more than 0.05 whatever the goal, and more than random actions."""
    scripted, random = (means("ext", scenario, 30, policy) for policy in ("scripted", "random"))
    for goal, score in scripted.items():
        assert score > 0.05, goal
        assert score > random[goal], goal


def coins(bench: OperationBench, kilojoules: float) -> list[int]:
    """Heating actions that add up to ``kilojoules``, the largest first."""
    sizes = next(process.magnitudes for process in bench.options.process if process.kind == "heat")
    actions: list[int] = []
    for size in sorted((size for size in sizes if size > 0.0), reverse=True):
        number = int((kilojoules + 1e-9) // size)
        actions += [bench.action_meanings.index(f"heat DV, {size:g} kJ")] * number
        kilojoules -= number * size
    return actions


def begin(batch: ExperimentBatch, goal: str, contents: dict[str, float]) -> None:
    """Start every member's experiment on the same contents."""
    batch.reset(batch.members, batch.scenario.goals.index(goal))
    for member in batch.members:
        batch.shelf.fill(int(member), 0, batch.bench.spec.start.capacity_l, contents)
    batch.bench.begin(batch.shelf, batch.experiments, batch.members)


def best_fixed_sequence(scenario: str, goal: str, contents: dict[str, float]) -> float:
    """Best score of: so much heat, then either the end, or the swap of receivers and so much heat again."""
    plans: list[tuple[float, float | None]] = [
        (4.0 * i, more) for i in range(76) for more in (None, 20.0, 40.0, 60.0, 80.0, 120.0, 160.0)
    ]
    batch = ExperimentBatch(scenario, "dit", len(plans))
    bench = batch.bench
    assert isinstance(bench, OperationBench)
    swap = bench.action_meanings.index("pour B1 -> B2, 100 %")
    sequences: Sequence[list[int]] = [
        coins(bench, first) + ([] if more is None else [swap, *coins(bench, more)]) for first, more in plans
    ]
    longest = max(map(len, sequences))
    assert longest < bench.spec.step_limit
    table = np.array([plan + [bench.end_action] * (longest + 1 - len(plan)) for plan in sequences])
    begin(batch, goal, contents)
    scores, running = np.full(len(plans), np.nan), batch.members.copy()
    for step in range(longest + 1):
        batch.act(table[running, step], running)
        ended = running[batch.experiments.ended[running]]
        if len(ended):
            scores[ended] = batch.finish(ended)
            running = running[~batch.experiments.ended[running]]
    return float(scores.max())


@pytest.mark.parametrize("accompanied", [False, True], ids=["alone", "with companion"])
@pytest.mark.parametrize(
    ("scenario", "goal"),
    [(name, goal) for name in ("wurtz_dodecane", "fictitious") for goal in load_scenario(name).goals],
)
def test_distillation_heuristic_is_near_the_best_fixed_sequence(scenario: str, goal: str, accompanied: bool) -> None:
    """At least 95 % of the best of 532 fixed sequences of actions, for every goal, with its companion and without."""
    batch = ExperimentBatch(scenario, "dit", 12)
    start = batch.bench.spec.start
    assert start.companion is not None
    contents = {**start.contents, goal: start.goal_mol}
    if accompanied:
        companion = start.companion
        contents[companion.if_goal if goal == companion.material else companion.material] = companion.mol
    for member in batch.members:
        batch.seed(int(member), int(member))
    begin(batch, goal, contents)
    mean = play_experiments(batch, scripted_bench(batch.bench)).mean()
    best = best_fixed_sequence(scenario, goal, contents)
    assert best > 0.6  # the search is no straw man: the most there is to gain is 0.8 or a little more
    assert mean >= 0.95 * best


def test_a_solvent_may_be_what_an_extraction_is_for() -> None:
    """It counts among itself and the solutes, not among other solvents: 4 mol of ether with 1 of dodecane is 4 / 5."""
    values = mapping("wurtz_dodecane")
    values["goals"] = ["dodecane", "diethyl_ether"]
    values["theoretical_maximum_mol"] = {"dodecane": 0.5}
    values["benches"]["ext"]["start"] = {"capacity_l": 1.2, "contents": {"diethyl_ether": 4.0, "dodecane": 1.0}}
    batch = ExperimentBatch(load_scenario({**values, "name": "ether"}), "ext", 1, "diethyl_ether")
    batch.seed(0, 0)
    batch.reset(batch.members)
    measured = batch.bench.measure(batch.shelf, batch.experiments, batch.members)
    assert float(measured[0]) == pytest.approx(4.0 * 4.0 / 5.0)


def test_reactions_that_are_too_stiff_are_an_error_that_says_where(tmp_path: Path) -> None:
    """Two isomers that turn into each other 1e9 times a tick: no explicit method gets there."""
    there, back = '{ "1-chlorohexane" = 1 }', '{ "2-chlorohexane" = 1 }'
    steps = "".join(
        f"[[reaction]]\nreactants = {a}\nproducts = {b}\npre_exponential = {k}\nactivation_energy_j_mol = 0\n"
        'source = "A test."\n'
        for a, b, k in ((there, back, 1e11), (back, there, 3e10))
    )
    (tmp_path / "isomers.toml").write_text(f'name = "isomers"\n{steps}', encoding="utf-8")
    values = mapping("wurtz_dodecane_direct")
    values |= {"name": "isomers", "reactions": str(tmp_path / "isomers.toml"), "goals": ["1-chlorohexane"]}
    values |= {"lab_goals": ["1-chlorohexane"], "theoretical_maximum_mol": {"1-chlorohexane": 1.0}}
    env = RoleEnv(load_scenario(values), bench="rxn")
    env.reset(seed=0)
    words = r"rxn_0: the reactions of laboratory 0 .* too stiff: more than 1,000,000 steps .*benches\.rxn\.tick"
    assert most_steps(ExperimentBatch("wurtz_real", "rxn").bench.chemistry) == 100_000
    with pytest.raises(ArithmeticError, match=words):
        env.step(np.ones(env.action_space.shape))
