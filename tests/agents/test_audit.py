"""The audit: its scale, its measures on scenarios of which the answers are known, going on where it was."""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import children, running, until
from scipy import stats

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.evaluate import jobs
from chemlab.agents.evaluate.audit import audit, choosing_jobs, measure_rows, verdict
from chemlab.agents.evaluate.jobs import AuditBudget, Job, JobRunner, foreseen
from chemlab.agents.evaluate.scale import Scale, interval
from chemlab.agents.evaluate.search import best_in_episode, search_plan
from chemlab.agents.policies import make_policies
from chemlab.config.loading import load_scenario
from chemlab.lab.engine import Laboratories
from chemlab.record import scenario_hash

TINY = AuditBudget(episodes=12, plans=20, fewer=5, donors=2, planned=6)
Audited = tuple[dict[str, Any], Path, Path]
MEASURES = (
    "random reference best strongest open_loop oracle value_of_information value_of_bench value_of_role "
    "value_of_memory coordination_gain contention value_of_reports headroom generalization open_loop_deviation criteria"
)


def test_the_scale_has_random_at_0_and_the_clairvoyant_at_1() -> None:
    draw = np.random.default_rng(1)
    random, oracle = draw.normal(-0.1, 0.1, 50), draw.normal(0.9, 0.1, 50)
    scale = Scale(random, oracle)
    assert interval(scale.mean(random)) == {"value": 0.0, "low": 0.0, "high": 0.0}
    assert interval(scale.mean(oracle)) == {"value": 1.0, "low": 1.0, "high": 1.0}
    # Half way between the two, episode by episode, is half way in every resample.
    assert interval(scale.mean(0.5 * (random + oracle)))["low"] == pytest.approx(0.5, rel=1e-12)
    assert scale.deviation(oracle)[0] == pytest.approx(oracle.std() / (oracle.mean() - random.mean()))


def test_the_interval_of_a_scale_that_does_not_vary_is_students() -> None:
    """Where every episode goes from 0 to 1, a normalized mean is a mean; of a single episode there is no interval."""
    scores = np.random.default_rng(3).normal(0.5, 0.2, 12)
    for n in (2, 3, 12):
        told = interval(Scale(np.zeros(n), np.ones(n)).mean(scores[:n]))
        ends = stats.ttest_1samp(scores[:n], 0.0).confidence_interval(0.95)
        assert (told["low"], told["high"]) == pytest.approx((ends.low, ends.high), rel=1e-9)
    assert interval(Scale(np.zeros(1), np.ones(1)).mean(scores[:1]))["low"] is None
    assert interval(Scale(np.zeros(2), np.ones(2)).deviation(scores[:2]))["high"] is None


@pytest.mark.parametrize("priced", [False, True])
def test_a_scenario_that_cannot_be_solved_is_said_to_be_one(priced: bool) -> None:
    """In one tick every policy scores 0: no scale. Where random actions cost, doing nothing is no solution either."""
    spec = load_scenario("wurtz_dodecane_direct")
    nothing: dict[str, Any] = {"limits": spec.limits.model_copy(update={"ticks": 1})}
    if not priced:
        free = {"stock_per_mol": {}, "waste_per_l": 0.0, "tick": 0.0, "illegal_action": 0.0}
        nothing["costs"] = spec.costs.model_copy(update=free)
        prices = {name: one.model_copy(update={"price": 0.0}) for name, one in spec.instruments.items()}
        nothing["instruments"] = prices
    found = audit(spec.model_copy(update=nothing), AuditBudget(2, 4, 2, 1, 4))
    assert found["impossible"] == verdict(found)
    assert "no policy and no plan that was tried scores above random legal play" in found["impossible"]
    assert set(found["criteria"].values()) == {None}
    assert list(measure_rows(found)) == []


COLD = Path(__file__).parent / "cold.toml"
"""A scenario of which every bench needs to be left cold: no observation is needed."""


@pytest.mark.slow
def test_constant_actions_of_benches_are_searched() -> None:
    """Scripted benches heat, so that a plan of the manager alone fails; with a constant cold bench it does not."""
    plan, everybody = (search_plan(COLD, budget=400, free=free) for free in (False, True))
    assert everybody.found[0].team.benches[0] is not None
    assert everybody.play(20, split="test").mean() > plan.play(20, split="test").mean() + 0.3


@pytest.mark.slow
def test_a_scenario_that_needs_memory_is_said_to_be_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A campaign's first batches tell of the later ones. Both policies are scripted; searches are left out."""
    searched = {"scores": [-1.0] * 20, "everybody": [-1.0] * 20, "chosen": [-1.0], "plans": [], "teams": []}
    for kind in ("plan", "everybody", "replay"):
        monkeypatch.setitem(jobs._KINDS, kind, lambda *_, **__: searched)
    planned = {"scores": [-1.0] * 10, "curves": [[-1.0] * 10] * 10}
    monkeypatch.setitem(jobs._KINDS, "foresee", lambda *_, **__: planned)
    found = audit("campaign", AuditBudget(episodes=20, plans=1, fewer=1, donors=1, planned=1))
    assert found["value_of_memory"]["low"] > 0.0


@pytest.mark.slow
def test_the_oracle_is_never_below_a_policy(one_goal: Audited) -> None:
    """Neither in the mean nor in an episode: the scale of the rows ends at 1."""
    found, keep, _ = one_goal
    scored = {path.stem: json.loads(path.read_text())["result"]["scores"] for path in keep.glob("*.json")}
    planner = foreseen({name: {"scores": own} for name, own in scored.items() if name.startswith("foresee")})
    rows = [np.array(scored[name]) for name in ("random", "test", "idle", "plan", "everybody", "replay")]
    assert np.maximum.reduce([planner, *rows]).mean() <= found["oracle"]["score"] + 1e-12
    assert found["strongest"]["value"] <= 1.0
    assert max(found["open_loop"]["ways"].values()) <= found["strongest"]["value"]


@pytest.fixture(scope="module")
def one_goal(tmp_path_factory: pytest.TempPathFactory) -> Audited:
    """An audit of `unlabelled` with one goal, the folder of its parts, and the scenario's file."""
    folder = tmp_path_factory.mktemp("audited")
    file = folder / "one_goal.toml"
    file.write_text('base = "unlabelled"\nname = "one_goal"\nlab_goals = ["dodecane"]\n')
    return audit(file, TINY, folder / "kept"), folder / "kept", file


@pytest.mark.slow
def test_an_audit_says_everything_that_it_promises(one_goal: Audited) -> None:
    found = one_goal[0]
    assert set(MEASURES.split()) <= set(found)
    assert set(found["value_of_bench"]) == {"rxn", "dit"}
    assert set(found["value_of_role"]) == {"manager_0", "rxn_0", "dit_0"}
    assert found["value_of_information"]["value"] == found["value_of_information"]["ways"]["scripted"]["value"]
    assert {row[0] for row in measure_rows(found)} >= {"value of rxn", "rxn_0 replaced", "information, scripted"}
    several = ("value_of_bench", "value_of_role")
    told = [found[name] for name in MEASURES.split() if name not in (*several, "criteria")]
    for measure in [*told, *(own for name in several for own in found[name].values())]:
        if measure["value"] is None:
            assert measure["reason"]
        else:
            assert measure["low"] <= measure["value"] <= measure["high"]
    assert json.loads(json.dumps(found)) == found
    assert found["headroom"]["value"] == pytest.approx(1.0 - found["best"]["value"])
    assert found["best"]["value"] >= found["reference"]["value"]
    assert found["open_loop"]["value"] == max(found["open_loop"]["ways"].values())
    assert np.diff(found["oracle"]["curve"]).min() >= 0.0
    assert found["oracle"]["curve"][-1] == pytest.approx(1.0)
    assert set(found["open_loop"]["ways"]) >= {"plan", "everybody", "replay"}
    assert "one_goal" in verdict(found)
    # Vessels look alike, so that looking is worth it; products are made at one bench and purified at the other.
    assert found["open_loop"]["high"] < found["best"]["low"]
    needed = ("value_of_information", "open_loop_deviation", "value_of_bench")
    assert all(found["criteria"][name] for name in needed)
    assert min(own["low"] for own in found["value_of_bench"].values()) > 0.1


@pytest.mark.slow
def test_an_audit_goes_on_where_it_was_broken_off(one_goal: Audited) -> None:
    found, keep, file = one_goal
    files = sorted(keep.glob("*.json"))
    kept = {file.name: file.stat().st_mtime_ns for file in files}
    (keep / "random.json").unlink()
    (keep / "test.json").write_text("{")
    seen: list[str] = []
    assert audit(file, TINY, keep, watch=seen.append) == found
    assert {file.stem for file in files} == {name.replace(":", "_") for name in seen}
    again = {file.name for file in files if file.stat().st_mtime_ns != kept[file.name]}
    assert again == {"random.json", "test.json"}


def killed(words: list[str], parts: Path, least: int) -> None:
    """Run a command with tiny budgets, and kill it (as ``kill -9`` does) once it has kept so many parts."""
    code = (
        "from chemlab.agents.evaluate import jobs\nfrom chemlab.cli import main\n"
        f"jobs.BUDGETS['small'] = jobs.{TINY}\nmain()\n"
    )
    with subprocess.Popen([sys.executable, "-c", code, *words], stderr=subprocess.DEVNULL) as process:
        while len(list(parts.rglob("*.json"))) < least:
            assert process.poll() is None, "it was over before it could be killed"
            time.sleep(0.005)
        workers = children(process.pid)
        process.kill()
    assert workers
    until(lambda: not any(map(running, workers)), 60.0)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes as Linux shows them")
@pytest.mark.slow
def test_an_audit_that_is_killed_goes_on(one_goal: Audited, tmp_path: Path) -> None:
    """Part by part what one that was not killed has kept, with which it goes on."""
    keep, out = tmp_path / "kept", tmp_path / "audit.json"
    killed(["audit", str(one_goal[2]), "--keep", str(keep), "--out", str(out), "--processes", "2"], keep, 4)
    assert not out.exists()
    for path in keep.glob("*.json"):
        assert path.read_bytes() == (one_goal[1] / path.name).read_bytes()


@pytest.mark.slow
def test_a_part_that_is_not_as_it_was_written_is_played_again(one_goal: Audited) -> None:
    """More of them are in ``tests/fuzz``."""
    spec, keep = load_scenario(one_goal[2]), one_goal[1]
    runner, path = JobRunner(spec, TINY, keep), keep / "plan.json"
    job, whole = next(job for job in choosing_jobs(spec) if job.name == "plan"), path.read_text()
    part = json.loads(whole)
    result = part["result"]
    assert runner.cached(job) == result
    other_plans = [[goals, [*plan, 0]] for goals, plan in result["plans"]]
    changes: list[dict[str, Any]] = [{"scores": [1.0]}, {"scores": [float("nan")] * TINY.episodes}, {"more": 1}]
    worse: list[Any] = [*({**result, **change} for change in [*changes, {"plans": other_plans}]), [], None]
    texts = [json.dumps({**part, "result": other}) for other in worse]
    texts += [json.dumps({**part, "stamp": other}) for other in (None, [], part["stamp"][:-1], "é")]
    try:
        for text in [*texts, "[" * 100_000, "", "null", " " * 20_000_000, whole[:-2]]:
            path.write_text(text)
            assert runner.cached(job) is None, text[:500]
    finally:
        path.write_text(whole)
    # Another policy under the same name, as after more training, is another job; other budgets and scenarios are, too.
    assert runner.cached(Job("plan", "plan", {"without": "rxn"})) is None
    assert JobRunner(spec, AuditBudget(7, 1, 1, 1, 1), keep).cached(job) is None
    assert JobRunner(load_scenario("failing"), TINY, keep).cached(job) is None


@pytest.mark.slow
def test_where_nothing_is_hidden_a_blind_plan_does() -> None:
    """The known plan of wurtz_dodecane_direct: react, distil, submit what has come over."""
    found = audit("wurtz_dodecane_direct", AuditBudget(6, 120, 20, 2, 20))
    assert not found["criteria"]["open_loop"]
    assert not found["criteria"]["value_of_information"]
    assert found["generalization"]["value"] is None
    assert "an open-loop policy (" in verdict(found)


def test_whoever_knows_the_world_is_never_below_who_looks() -> None:
    labs = Laboratories("unlabelled", 4, split="test")
    scores = play_laboratory(labs, make_policies("scripted", labs, 0), None, 70).returns
    for member in range(4):
        best, curve = best_in_episode(labs.scenario, 70 + member, "test", 20)
        # The scripted manager's own plan there, without its measurements.
        assert best >= scores[member] + labs.state.charges[member, 0] - 1e-9
        assert [score for _, score in curve] == sorted(score for _, score in curve)


def test_stored_audits_are_of_the_scenarios_as_they_are() -> None:
    paths = sorted((Path(__file__).parents[2] / "docs" / "results" / "audits").glob("*.json"))
    assert len(paths) > 10
    for path in paths:
        found = json.loads(path.read_text(encoding="utf-8"))
        assert found["scenario"] == path.stem
        again = f"make it again: chemlab audit {path.stem} --out {path}"
        assert found["scenario_hash"] == scenario_hash(load_scenario(path.stem)), again
