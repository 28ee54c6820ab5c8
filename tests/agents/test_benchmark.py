"""The benchmark's protocol: its scale and statistics, going on where it was, and what it writes."""

import itertools
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import command, refused
from run_files import trained, write_run
from scipy import stats

from chemlab import __version__
from chemlab.agents.episodes import play_episode, play_laboratory, record_episode
from chemlab.agents.evaluate import statistics
from chemlab.agents.evaluate.benchmark import Row, benchmark, check_rows, find_rows, part_count, write_benchmark
from chemlab.agents.evaluate.jobs import AUDIT_SEED, BUDGETS, AuditBudget, Job, JobRunner
from chemlab.agents.evaluate.leaderboard import (
    check_leaderboard,
    leaderboard_lines,
    on_scale,
    runs_of,
    write_leaderboard,
)
from chemlab.agents.policies import make_policies, policy_files
from chemlab.agents.pretrained import load_pretrained, save_policy
from chemlab.agents.runs import Run
from chemlab.agents.seats import Room
from chemlab.config.loading import load_scenario
from chemlab.envs.aec import raw_env
from chemlab.lab.engine import Laboratories
from chemlab.record import Recorder, RecordError, scenario_hash, verify_record
from studies.tools.seats import play_scripted

TINY = AuditBudget(episodes=5, plans=20, fewer=5, donors=2, planned=5)
Played = tuple[dict[str, Any], Path]
DIRECT = "wurtz_dodecane_direct"
ROWS = [Row(name, (name,)) for name in ("scripted", "scripted:unsafe", "scripted:fifo")]


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Played:
    folder = tmp_path_factory.mktemp("benchmark")
    benchmark([DIRECT], ROWS[:1], TINY, 2, keep=folder / "parts")
    return benchmark(["unlabelled"], ROWS, TINY, 2, keep=folder / "parts"), folder


def test_scores_are_those_of_the_episodes(played: Played) -> None:
    """Played again by hand: the whole, and each replication's part of it, on the scale from random to the oracle."""
    cells = played[0]["scenarios"]["unlabelled"]["cells"]
    cell, (random, oracle) = cells["scripted"], (np.array(cells[name]["scores"]) for name in ("random", "oracle"))
    span, scores = oracle.mean() - random.mean(), {}
    for split in ("test", "train"):
        labs = Laboratories("unlabelled", 5, split=split)
        scores[split] = play_laboratory(labs, make_policies("scripted", labs), None, AUDIT_SEED).returns
    assert cell["score"] == pytest.approx(scores["test"].mean(), rel=1e-12)
    assert cell["value"] == pytest.approx((scores["test"].mean() - random.mean()) / span)
    assert cell["generalization"]["value"] == pytest.approx((scores["test"].mean() - scores["train"].mean()) / span)
    parts = (slice(0, 3), slice(3, 5))
    shares = [(scores["test"][p].mean() - random[p].mean()) / (oracle[p].mean() - random[p].mean()) for p in parts]
    for name, value, own in (("scripted", cell["value"], shares), ("oracle", 1, [1, 1]), ("random", 0, [0, 0])):
        assert cells[name]["value"] == pytest.approx(value, abs=1e-12)
        assert cells[name]["replications"] == pytest.approx(own)
    assert all(one["value"] <= 1.0 + 1e-12 for one in cells.values() if one["value"] is not None)
    assert "has no orders to choose from" in cells["scripted:fifo"]["reason"]
    # Against the baseline episode by episode, whatever these have in common.
    over = cells["random"]["over_baseline"]
    assert over["value"] == pytest.approx(-cell["value"])
    assert over["low"] <= over["value"] <= over["high"] < 0.0
    assert "over_baseline" not in cell


def test_rows_are_compared_over_scenarios(played: Played) -> None:
    found = {row["policy"]: row for row in played[0]["rows"]}
    cells = played[0]["scenarios"]["unlabelled"]["cells"]
    assert found["scripted"]["improvement"] is None
    for name in ("random", "scripted:unsafe"):
        ours, theirs = (np.array(cells[row]["replications"]) for row in (name, "scripted"))
        wins = np.mean([(x > y) + 0.5 * (x == y) for x in ours for y in theirs])
        assert found[name]["improvement"]["value"] == pytest.approx(wins)
        assert found[name]["interquartile_mean"]["value"] == pytest.approx(ours.mean())  # of two: nothing is cut off
        shares = [estimate["value"] for estimate in found[name]["profile"]]
        assert shares == [np.mean(ours > level) for level in played[0]["thresholds"]]
    assert found["scripted:fifo"]["scenarios"] == 0


def test_profiles_are_shares_of_samples_with_intervals() -> None:
    profile = statistics.performance_profile([[0.0, 0.5, 1.0, 1.0], [0.25, 0.75]], [-1.0, 0.5, 2.0])
    assert [estimate.value for estimate in profile] == [1.0, (0.5 + 0.5) / 2, 0.0]
    assert profile[0].low < profile[0].high == 1.0, "all of six samples are not all there are"
    assert profile[1].low < profile[1].value < profile[1].high
    assert statistics.performance_profile([[0.3]], [0.0])[0].low is None


def test_it_goes_on_where_it_was_and_writes_what_others_read(played: Played) -> None:
    found, folder = played
    spec = load_scenario("unlabelled")
    files = sorted((folder / "parts" / "unlabelled").glob("*.json"))
    assert len(files) == part_count([spec], ROWS, TINY, 2, "test")
    (folder / "parts" / "unlabelled" / "random.json").unlink()
    seen: list[str] = []
    assert benchmark([spec], ROWS, TINY, 2, keep=folder / "parts", watch=seen.append) == found
    assert len(seen) == len(files)
    write_benchmark(folder, found, [spec], ROWS)
    assert json.loads((folder / "benchmark.json").read_text()) == json.loads(json.dumps(found))
    runs = json.loads((folder / "marl_eval.json").read_text())["chemlab"]["unlabelled"]
    assert set(runs) == {"random", "plan", "scripted", "scripted:unsafe", "oracle"}
    assert set(runs["scripted:unsafe"]) == {"seed_0", "seed_1"}
    last = runs["scripted:unsafe"]["seed_1"]
    cell = found["scenarios"]["unlabelled"]["cells"]["scripted:unsafe"]
    assert last["absolute_metrics"]["return"] == pytest.approx([cell["replications"][1]])
    assert len(last["step_0"]["return"]) == 2
    assert np.mean(last["step_0"]["return"]) == pytest.approx(cell["replications"][1])


def test_lines_of_several_commands_are_on_one_scale(played: Played, tmp_path: Path) -> None:
    """That of whoever was best in any of them; the planner of the command that ends lower does not lower it again."""
    found, _ = played
    spec = load_scenario("unlabelled")

    def written(path: Path, *before: dict[str, Any]) -> dict[str, dict[str, Any]]:
        path.mkdir(exist_ok=True)
        if before:
            (path / "leaderboard.json").write_text(json.dumps({"lines": before}))
        write_benchmark(path, found, [spec], ROWS, records=0)
        return {line["policy"]: line for line in leaderboard_lines(path / "leaderboard.json")}

    own = written(tmp_path / "own")
    zero, end = (own["scripted:unsafe"]["scale"][key] for key in ("random", "oracle"))
    assert own["scripted:unsafe"]["value"] == pytest.approx((own["scripted:unsafe"]["score"] - zero) / (end - zero))
    # A command whose planner came to less: its lines come to less on this one's scale.
    low = {"random": zero, "oracle": (zero + end) / 2.0}
    somebody = {
        **own["scripted:unsafe"],
        "policy": "somebody",
        "scale": low,
        "value": 2.0 * own["scripted:unsafe"]["value"],
    }
    worse = {**own["oracle"], "scores": [score - 0.1 for score in own["oracle"]["scores"]], "scale": low}
    lines = written(tmp_path / "lower", somebody, worse)
    assert lines == own | {"somebody": {**own["scripted:unsafe"], "policy": "somebody"}}
    # Other episodes, or other worlds: nothing to compare.
    others: list[dict[str, Any]] = [
        {**somebody, "policy": "a", "scale": {"random": zero + 0.1, "oracle": end}},
        {**somebody, "policy": "b", "scenario_hash": "another"},
        {**somebody, "policy": "c", "split": "validation"},
    ]
    lines = written(tmp_path / "others", *others)
    assert [lines[line["policy"]] for line in others] == others
    *known, last = [line["value"] for line in lines.values()]
    assert (known, last) == (sorted(known, reverse=True), None)


def test_a_line_follows_from_the_scores_of_its_episodes(played: Played, tmp_path: Path) -> None:
    """Mean, scale, intervals and records are computed again; whatever is changed is found, and no other line is."""
    found, _ = played
    write_benchmark(tmp_path, found, [load_scenario("unlabelled")], ROWS)
    path = tmp_path / "leaderboard.json"
    checks = {check.policy: check for check in check_leaderboard(path)}
    proofs = dict.fromkeys(checks, "all") | {"scripted:fifo": "empty"}
    assert {name: check.proof for name, check in checks.items()} == proofs
    assert [check.faults for check in checks.values()] == [[]] * len(checks)
    assert {name for name, check in checks.items() if check.records} == {"scripted", "scripted:unsafe", "plan"}
    assert "6 lines; 5 follow from their scores" in command("verify", path)
    by_name = {line["policy"]: line for line in leaderboard_lines(path)}
    hasty, (first,) = by_name["scripted:unsafe"], by_name["scripted:unsafe"]["records"]
    scores, mean, ends = hasty["scores"], hasty["over_baseline"], hasty["scale"]
    assert first["score"] == pytest.approx(scores[0], rel=1e-9)
    assert verify_record(tmp_path / first["file"]).status == "ok"
    assert hasty["hardware"]["cores"]
    assert hasty["versions"]["chemlab"]
    assert by_name["scripted:fifo"]["reason"]
    for changed, what in (
        ({"value": hasty["value"] + 1e-6}, "value"),
        ({"low": hasty["low"] + 1e-6}, "low"),
        ({"high": None}, "high"),
        ({"score": hasty["score"] + 1e-6}, "score"),
        ({"episodes": 6}, "episodes"),
        ({"scores": [scores[0] + 1e-3, *scores[1:]]}, f"{first['file']}: its score is"),
        ({"scores": [*scores[:4], None]}, "episodes"),
        ({"scale": {**ends, "oracle": ends["oracle"] + 1e-6}}, "scale.oracle"),
        ({"scale": {**ends, "random": ends["random"] - 1e-6}}, "scale.random"),
        (
            {"scale": {"random": ends["oracle"], "oracle": ends["random"]}, "value": 5.0},
            "has no valid scale",
        ),
        ({"over_baseline": {**mean, "value": mean["value"] + 1e-6}}, "over_baseline.value"),
        ({"over_baseline": {**mean, "high": mean["high"] - 1e-6}}, "over_baseline.high"),
        ({"records": [{**first, "score": first["score"] + 1e-6}]}, f"{first['file']}: its replay gives"),
        ({"records": [{**first, "seed": first["seed"] + 1}]}, f"{first['file']}: is of unlabelled, seed 4000000"),
        ({"records": [{**first, "file": "records/none.jsonl"}]}, "records/none.jsonl: "),
        ({"records": [{**first, "file": "../leaderboard.json"}]}, "is not below the leaderboard's folder"),
    ):
        lines = [{**line, **changed} if line is hasty else line for line in by_name.values()]
        path.write_text(json.dumps({"lines": lines}))
        wrong = {check.policy: check.faults for check in check_leaderboard(path) if check.faults}
        assert set(wrong) == {"scripted:unsafe"}, changed
        assert any(what in fault for fault in wrong["scripted:unsafe"]), (changed, wrong)
    assert "unlabelled, scripted:unsafe: ../leaderboard.json" in command("verify", path, code=1)
    path.write_text(json.dumps({"lines": [{**hasty, "scores": [1e308] * 5}]}))
    refused("less than or equal to", check_leaderboard, path)
    path.write_text(json.dumps({"lines": [{key: value for key, value in hasty.items() if key != "scores"}]}))
    refused("value: needs the scores", check_leaderboard, path)
    # Without the planner's line, the mean alone is proven.
    path.write_text(json.dumps({"lines": [line for line in by_name.values() if line is not by_name["oracle"]]}))
    assert {check.policy: check.proof for check in check_leaderboard(path)}["scripted:unsafe"] == "score"


def test_what_a_record_claims_does_not_prove_a_line(tmp_path: Path) -> None:
    """Another version with numbers of its own, the best part of an episode, a scenario with the bundled one's name."""
    bundled = load_scenario("unlabelled")
    easier = bundled.model_copy(update={"costs": bundled.costs.model_copy(update={"tick": 0.0})})
    texts, scores = [], []
    for spec in (bundled, easier):
        env = raw_env(spec, split="test")
        policies = make_policies("scripted:unsafe", env.laboratories)
        scores.append(record_episode(tmp_path / "a.jsonl", env, policies, AUDIT_SEED, force=True).score)
        texts.append((tmp_path / "a.jsonl").read_text())
    elsewhere = texts[0].replace(f'"chemlab":"{__version__}"', '"chemlab":"9.9"', 1)
    begun = "".join(elsewhere.splitlines(keepends=True)[:2])
    (tmp_path / "a.jsonl").write_text(begun)
    so_far = verify_record(tmp_path / "a.jsonl").score
    ends = {"random": 0.0, "oracle": 1.0}
    line: dict[str, Any] = {"scenario": "unlabelled", "policy": "a", "episodes": 1, "scale": ends}
    for text, score, count, what, *split in (
        (elsewhere, scores[0], 1, ""),
        (elsewhere.replace(f'"score":{scores[0]!r}', '"score":5.0'), 5.0, 1, "other: made by chemlab 9.9"),
        (begun, so_far, 1, "other: made by chemlab 9.9"),
        (texts[1], scores[1], 1, "is of another unlabelled than the bundled one"),
        (texts[0], scores[0], 2, "two are of one episode"),
        (texts[0].replace('"split":"test"', '"split":"private"', 1), scores[0], 1, "must be train", "private:x"),
    ):
        (tmp_path / "a.jsonl").write_text(text)
        records = [{"file": "a.jsonl", "seed": AUDIT_SEED, "score": score}] * count
        line |= {"value": score, "records": records, "split": (split or ["test"])[0]}
        played = {"score": score, "scores": [score]}
        played["scenario_hash"] = scenario_hash(easier if text is texts[1] else bundled)
        (tmp_path / "board.json").write_text(json.dumps({"lines": [{**line, **played}]}))
        (check,) = check_leaderboard(tmp_path / "board.json")
        assert (bool(check.faults), what in "".join(check.faults)) == (bool(what), True), (what, check.faults)


def test_a_longer_scale_is_computed_from_its_scores(played: Played, tmp_path: Path) -> None:
    """A planner that comes to more in each episode, not to a constant more: intervals are those of its own scale."""
    write_benchmark(tmp_path, played[0], [load_scenario("unlabelled")], ROWS, records=0)
    path = tmp_path / "leaderboard.json"
    lines = {line["policy"]: line for line in leaderboard_lines(path)}
    planner, ends = lines["oracle"], lines["oracle"]["scale"]
    more = [score + 0.1 * (k + 1) for k, score in enumerate(planner["scores"])]
    score = float(np.mean(more))
    better = {**planner, "scores": more, "score": score, "scale": {**ends, "oracle": score}}
    write_leaderboard(path, [better])
    assert [check.faults for check in check_leaderboard(path)] == [[]] * 6
    hasty = next(line for line in leaderboard_lines(path) if line["policy"] == "scripted:unsafe")
    assert hasty["value"] == pytest.approx((hasty["score"] - ends["random"]) / (score - ends["random"]))
    factor = hasty["value"] / lines["scripted:unsafe"]["value"]
    assert hasty["high"] != pytest.approx(lines["scripted:unsafe"]["high"] * factor, rel=1e-6)
    # One that comes to more in a single episode, and to less in all: the planner's score is the higher one in each.
    other = [more[0] + 1.0, *planner["scores"][1:]]
    write_leaderboard(path, [{**planner, "scores": other, "score": float(np.mean(other)), "scale": ends}])
    lines = {line["policy"]: line for line in leaderboard_lines(path)}
    assert lines["oracle"]["scores"] == [other[0], *more[1:]]
    assert [check.faults for check in check_leaderboard(path)] == [[]] * 6
    # Nobody is above the planner, however well the rest follows from such scores.
    above = {**lines["scripted"], "policy": "a", "scores": [other[0] + 0.1, *other[1:]]}
    path.write_text(json.dumps({"lines": [*lines.values(), above]}))
    assert any("above the oracle's" in fault for fault in check_leaderboard(path)[-1].faults)


def test_the_interval_of_a_row_of_several_runs_is_over_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Student's of the means of runs, over all scenarios: replications of one run are one sample."""

    def played(runner: JobRunner, jobs: list[Job]) -> dict[str, Any]:
        def scores(policy: str = "oracle", episodes: int = 5, **_: Any) -> list[float]:
            return [{"random": 0.0, "a": 0.2, "b": 0.5}.get(policy, 1.0)] * episodes

        return {job.name: {"scores": scores(**job.arguments), "plans": []} for job in jobs}

    monkeypatch.setattr(JobRunner, "run", played)
    row = benchmark(["unlabelled"], [Row("r", ("a", "b"))], TINY, 5, baseline="plan")["rows"][2]
    ends = stats.ttest_1samp([0.2, 0.5], 0.0).confidence_interval(0.95)
    assert (row["mean"]["low"], row["mean"]["high"]) == pytest.approx((ends.low, ends.high))
    scores = np.array([0.1, 0.2, 0.5, 0.6, 0.3, 0.4, 0.2, 0.1])
    runs = runs_of(2, 4, 8)
    assert runs == [0, 0, 1, 1, 0, 0, 1, 1]
    assert runs_of(1, 4, 8) is None
    means = [scores[[0, 1, 4, 5]].mean(), scores[[2, 3, 6, 7]].mean()]
    for of, sample in ((runs, means), (None, scores)):
        found: Any = on_scale(scores, np.zeros(8), np.ones(8), of)
        ends = stats.ttest_1samp(sample, 0.0).confidence_interval(0.95)
        assert (found["low"], found["high"]) == pytest.approx((ends.low, ends.high))


def test_where_nobody_is_above_random_play_there_is_no_scale() -> None:
    """A cell of such episodes is empty, instead of a score divided by next to nothing."""
    for rounding in (0.0, 1e-17):
        assert on_scale(np.array([-0.1, -0.2]), np.zeros(2), np.full(2, rounding)) is None
    half: Any = on_scale(np.array([0.0, 0.5]), np.zeros(2), np.array([0.0, 1.0]))
    assert half["value"] == 0.5
    assert half["low"] is None, "without the second episode there is no scale, so nobody knows how it varies"


def recorded(path: Path, seed: int, split: str = "test", who: str = "human", **more: Any) -> float:
    """A game of unlabelled, as `chemlab play` writes it; the manager's part has a policy that looks at nothing.

    ``more`` is a scenario, or a goal that is asked for.
    """
    env = raw_env(more.pop("scenario", "unlabelled"), split=split)
    labs = env.laboratories
    policies = make_policies("scripted,manager=scripted:unsafe", labs, seed)
    names = dict.fromkeys(labs.agents, "scripted") | {labs.agents[0]: who}
    with Recorder(path, labs, policies=names) as recorder:
        return float(play_episode(env, policies, seed, who, None, more or None, recorder).score)


@pytest.mark.slow
def test_what_people_have_played_is_entered_like_any_other(tmp_path: Path, played: Played) -> None:
    """They have played two of five episodes: their scores are those of the records, on the scale of these two."""
    games, keep = tmp_path / "people", tmp_path / "out"
    games.mkdir()
    scores = [recorded(games / f"{k}.jsonl", AUDIT_SEED + k) for k in (0, 3)]
    (row,) = find_rows([str(games)])
    shutil.copytree(played[1] / "parts", keep / "parts")
    rows, seen = [ROWS[0], row], list[str]()
    found = benchmark(["unlabelled"], rows, TINY, 2, keep=keep / "parts", watch=seen.append)
    assert seen[:2] == [str(games / f"{k}.jsonl") for k in (0, 3)]
    assert len(seen) == part_count([load_scenario("unlabelled")], rows, TINY, 2, "test")
    cells = found["scenarios"]["unlabelled"]["cells"]
    cell = cells[str(games)]
    assert cell["scores"] == [scores[0], None, None, scores[1], None]
    assert (cell["episodes"], cell["score"]) == (2, pytest.approx(np.mean(scores)))
    zero, one, script = (np.array(cells[name]["scores"])[[0, 3]].mean() for name in ("random", "oracle", "scripted"))
    assert cell["value"] == pytest.approx((np.mean(scores) - zero) / (one - zero))
    assert cell["over_baseline"]["value"] == pytest.approx((np.mean(scores) - script) / (one - zero))
    assert len(cell["replications"]) == 2, "one episode in each"
    script_alone = [(cells["scripted"]["scores"][k] - cells["random"]["scores"][k]) for k in (0, 3)]
    spans = [cells["oracle"]["scores"][k] - cells["random"]["scores"][k] for k in (0, 3)]
    assert cell["baseline"] == pytest.approx(np.array(script_alone) / spans), "in the same episodes, not in all"
    (summary,) = (one for one in found["rows"] if one["policy"] == str(games))
    expected = statistics.probability_of_improvement([cell["replications"]], [cell["baseline"]])
    assert summary["improvement"]["value"] == expected.value
    assert cells["scripted"]["value"] == played[0]["scenarios"]["unlabelled"]["cells"]["scripted"]["value"]
    write_benchmark(keep, found, [load_scenario("unlabelled")], rows, records=0)
    (line,) = (line for line in leaderboard_lines(keep / "leaderboard.json") if line["policy"] == str(games))
    assert (line["episodes"], line["value"]) == (2, cell["value"])
    seeds = zip((AUDIT_SEED, AUDIT_SEED + 3), scores, strict=True)
    assert [(entry["seed"], entry["score"]) for entry in line["records"]] == list(seeds)
    for entry in line["records"]:
        assert verify_record(keep / entry["file"]).status == "ok"
    assert str(games) not in json.loads((keep / "marl_eval.json").read_text())["chemlab"]["unlabelled"]
    elsewhere = benchmark([DIRECT], [ROWS[0], row], TINY, 2, keep=keep / "parts")
    nobody = elsewhere["scenarios"][DIRECT]["cells"][str(games)]
    assert (nobody["value"], nobody["reason"]) == (None, "has not been played yet")


def test_people_play_the_worlds_that_are_scored(tmp_path: Path) -> None:
    file = tmp_path / "people" / "game.jsonl"
    words = ["play", "selectivity", "--split", "test", "--seed", str(AUDIT_SEED), "--record", str(file)]
    command(*words, input="start rxn_0 on slot 0\nwait\nsubmit slot 0\n")
    (row,) = find_rows([str(file)])
    assert [(name, record.path) for name, record in row.records] == [("selectivity", file)]
    assert find_rows([str(file.parent) + "/"])[0].name == str(file.parent), "one folder has one name"


def test_records_that_prove_nothing_are_refused_before_anything_is_played(tmp_path: Path) -> None:
    def refuse(match: str, *files: Path) -> None:
        rows, keep, seen = [ROWS[0], *find_rows([str(files[0].parent)])], tmp_path / "parts", list[str]()
        refused(match, benchmark, ["unlabelled"], rows, TINY, 2, keep=keep, watch=seen.append)
        assert not keep.exists()
        assert seen in ([], [str(files[0])])

    def game(name: str, *arguments: Any, **others: Any) -> Path:
        (tmp_path / name).mkdir(exist_ok=True)
        path = tmp_path / name / f"{len(list((tmp_path / name).iterdir()))}.jsonl"
        recorded(path, *arguments, **others)
        return path

    refuse("seeds 4000000 to 4000004, split test.*its seed is 7", game("seed", 7))
    refuse("its split train", game("split", AUDIT_SEED, split="train"))
    refuse("its options goal", game("goal", AUDIT_SEED, goal=load_scenario("unlabelled").lab_goals[0]))
    refuse("is of seed 4000000, and so is", game("twice", AUDIT_SEED), game("twice", AUDIT_SEED))
    torn = game("torn", AUDIT_SEED)
    torn.write_text("".join(torn.read_text().splitlines(keepends=True)[:-1]))
    refuse("the end is missing", torn)
    better = game("better", AUDIT_SEED)
    *lines, end = better.read_text().splitlines()
    told = json.loads(end)
    told["end"]["score"] = 0.99
    better.write_text("\n".join([*lines, json.dumps(told)]) + "\n")
    refuse("0.99", better)
    spec = load_scenario("unlabelled")
    cheap = spec.model_copy(update={"costs": spec.costs.model_copy(update={"tick": spec.costs.tick + 1e-3})})
    other = tmp_path / "other" / "0.jsonl"
    other.parent.mkdir()
    recorded(other, AUDIT_SEED, scenario=cheap)
    refuse(r"is of another unlabelled than .*unlabelled.toml", other)
    header, *rest = other.read_text().splitlines()
    other.write_text("\n".join([json.dumps(json.loads(header) | {"chemlab": "0.0.1"}), *rest]) + "\n")
    refuse(r"is of another unlabelled than .*unlabelled.toml", other)
    refused(r"p/q.*: given twice", find_rows, [str(tmp_path / "p/q"), str(tmp_path / "p_q")])
    with pytest.raises(ValueError, match=r"baseline: .*0.jsonl: must play all episodes"):
        benchmark(["unlabelled"], find_rows([str(other)]), TINY, 2, baseline=str(other))
    game("several", AUDIT_SEED)
    game("several", AUDIT_SEED + 1, who="somebody else")
    refused(r"manager_0 is human in .*0.jsonl, and somebody else in .*1.jsonl", find_rows, [str(tmp_path / "several")])


def test_a_row_has_a_run_for_each_seed(tmp_path: Path) -> None:
    """A repetition with the same seed is no replication."""
    for name in ("a", "b"):
        write_run(tmp_path / "runs" / name, "unlabelled", "manager", {"F": 0.5})
    refused(r"runs.b has the seed of .*runs.a, 0: leave one", find_rows, [str(tmp_path / "runs")])


def test_checkpoints_and_names_of_policies_are_no_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkpoint has files of lines, too; and a folder that is called as a policy is, is none."""
    checkpoint = tmp_path / "checkpoints" / "last-10"
    for folder in (checkpoint, tmp_path / "scripted"):
        folder.mkdir(parents=True)
        (folder / "curve.jsonl").write_text("{}\n")
    monkeypatch.chdir(tmp_path)
    assert find_rows([str(checkpoint), "scripted"]) == [Row(name, (name,)) for name in (str(checkpoint), "scripted")]
    with pytest.raises(RecordError, match="is not a record of an episode"):
        find_rows([str(checkpoint / "curve.jsonl")])


def test_what_is_no_leaderboard_is_said_before_anything_is_played(tmp_path: Path) -> None:
    path = tmp_path / "leaderboard.json"
    assert leaderboard_lines(path) == []
    line = {"scenario": "a", "policy": "b", "split": "test", "scenario_hash": "c", "value": None, "more": [1, "x"]}
    path.write_text(json.dumps({"lines": [line]}))
    assert leaderboard_lines(path) == [line]
    texts = [json.dumps({"lines": [{**line, key: value}]}) for key, value in (("value", "x"), ("policy", 1))]
    texts += [json.dumps({"lines": [{"scenario": "a"}]}), '{"lines": [{"value": NaN}]}', "[]", "null", "", "[" * 9999]
    texts += [json.dumps({"lines": [{**line, "policy": "\x1b[31m"}]}), json.dumps({"lines": [line] * 20_000})]
    for text in texts:
        path.write_text(text)
        said = command("benchmark", "unlabelled", "--out", tmp_path, code=2)
        assert ("leaderboard.json" in said, "\x1b" in said) == (True, False), text[:80]
    assert sorted(tmp_path.iterdir()) == [path]


@pytest.mark.slow
def test_a_folder_of_runs_is_a_row_for_best_and_one_for_last(played: Played, tmp_path: Path) -> None:
    manager = {"scenario": "unlabelled", "roles": "manager", "algo": "maskable-ppo"}
    for seed in (0, 1):
        trained(tmp_path / "runs" / f"seed-{seed}", seed=seed, **manager)
    rows = find_rows([str(tmp_path / "runs")])
    assert [row.name.rpartition(" ")[2] for row in rows] == ["(best)", "(last)"]
    for seed in (0, 1):
        assert rows[1].policies[seed] == str(Run(tmp_path / "runs" / f"seed-{seed}").checkpoint("last"))
    shutil.copytree(played[1] / "parts", tmp_path / "parts")
    found = benchmark(["unlabelled", DIRECT], rows, TINY, 2, baseline=rows[0].name, keep=tmp_path / "parts")
    cells = found["scenarios"]["unlabelled"]["cells"]
    labs = Laboratories("unlabelled", 5, split="test")
    scores = [play_laboratory(labs, make_policies(one, labs), None, AUDIT_SEED).returns for one in rows[1].policies]
    # The first replication is the first run's, the second the second's, each in worlds of its own.
    assert cells[rows[1].name]["score"] == pytest.approx(np.concatenate([scores[0][:3], scores[1][3:]]).mean())
    assert found["scenarios"][DIRECT]["cells"][rows[0].name]["reason"] == "was trained in unlabelled"
    assert found["rows"][2]["hours"] > 0.0
    assert found["rows"][2]["steps"] == 32
    refused("given twice", find_rows, ["scripted", "scripted"])
    with pytest.raises(ValueError, match=r"\(best\) has 2 runs, .* give at least as many, given 1"):
        benchmark(["unlabelled"], rows, TINY, 1, baseline="random")


def test_the_command(played: Played, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # It goes on from what has been played, but for what it is asked for besides.
    shutil.copytree(played[1] / "parts", tmp_path / "parts")
    monkeypatch.setitem(BUDGETS, "small", TINY)
    words = f"benchmark unlabelled --policy scripted:unsafe --seeds 2 --processes 1 --out {tmp_path}".split()
    said = command(*words)
    for name in ("random", "plan", "scripted", "scripted:unsafe", "oracle", "2 replications"):
        assert name in said
    assert (tmp_path / "leaderboard.json").exists()
    assert json.loads(command(*words, "--json"))["kind"] == "benchmark"
    assert "from 1 to the 5 episodes of the budget, given 6" in command(*words, "--seeds", 6, code=2)


def test_what_cannot_be_is_refused() -> None:
    spec, row = load_scenario("unlabelled"), Row("team (best)", ("scripted",), scenario="rush")
    refused("baseline: known: random, plan, oracle; given 'scripted'", benchmark, ["unlabelled"], [], TINY, 2)
    refused(r"policies: scriptd: .*did you mean scripted", lambda: check_rows([spec], find_rows(["scriptd"])))
    refused(r"policies: team \(best\): was trained in rush", check_rows, [spec], [row])
    check_rows([spec, load_scenario("rush")], [row, *find_rows(["scripted"])])


def test_a_run_on_a_file_fits_the_file_however_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text('base = "rush"\nname = "mine"\n')
    for name, (level, other) in itertools.product(("mine.toml", str(tmp_path / "mine.toml")), (("", "@1"), ("@1", ""))):
        row = Row("run", ("scripted",), scenario=f"mine.toml{level}")
        check_rows([load_scenario(name + level)], [row])
        refused(f"run: was trained in mine.toml{level}", check_rows, [load_scenario(name + other)], [row])


def test_a_cached_part_belongs_to_the_weights_that_played(tmp_path: Path) -> None:
    """Not to another policy that has been exported to the same path, or is its background."""
    spec, manager = load_scenario("unlabelled"), load_pretrained("unlabelled_manager")
    save_policy(tmp_path / "one", manager.card.model_copy(update={"name": "one"}), manager.weights)
    job = Job("row", "play", {"policy": f"scripted,manager={tmp_path / 'one'}:sampled@0.1", "split": "test", "seed": 0})
    made = JobRunner(spec, TINY, tmp_path / "kept").run([job])["row"]
    assert JobRunner(spec, TINY, tmp_path / "kept").cached(job) == made
    weights = {name: -values for name, values in manager.weights.items()}
    save_policy(tmp_path / "one", manager.card.model_copy(update={"name": "one"}), weights)
    assert JobRunner(spec, TINY, tmp_path / "kept").cached(job) is None
    assert policy_files("scripted") == policy_files("random@0.2") == []
    pupil = manager.card.model_copy(update={"name": "pupil", "advice": str(tmp_path / "one.json")})
    save_policy(tmp_path / "pupil", pupil, manager.weights)
    assert {file.name for file in policy_files(str(tmp_path / "pupil"))} >= {"pupil.safetensors", "one.safetensors"}
    plan = policy_files(f"plan:{tmp_path / 'plan.json'},rxn={tmp_path / 'one.json'}")
    assert plan == [tmp_path / name for name in ("plan.json", "one.json", "one.safetensors")]


@pytest.mark.slow
def test_seats_are_entered_with_condition_calls_and_tokens(tmp_path: Path) -> None:
    """All episodes of a ledger count, those without calls left as they stood; a salt known to the operator alone."""
    folder, keep, salt = tmp_path / "seats", tmp_path / "out", "0123456789abcdef" * 2
    seat: dict[str, Any] = {"folder": folder, "salt": salt, "condition": "tools only"}
    for episode, budget in ((0, 400), (3, 400)):
        room = Room("unlabelled", calls=budget, seed=AUDIT_SEED + episode, **seat)
        room.spent("manager_0", 500)
        if episode == 0:
            calls = len(play_scripted(room))
        while not room.over:
            room.call("manager_0", "nothing")
        room.close()
    assert salt not in (folder / "ledger.jsonl").read_text()
    (row,) = find_rows([str(folder)])
    found = benchmark(["unlabelled"], [ROWS[0], row], TINY, 2, split=f"private:{salt}")
    cell = found["scenarios"]["unlabelled"]["cells"][str(folder)]
    assert cell["scores"][1:] == [None, None, pytest.approx(-0.1), None]
    assert cell["scores"][0] > 0.0
    counts = {"calls": (calls + 401) / 2, "tokens": 500.0, "wrong": 200.0}
    counts |= {"condition": "tools only", "names": "plain", "budget": 400}
    assert counts.items() <= cell["seats"].items()
    write_benchmark(keep, found, [load_scenario("unlabelled")], [ROWS[0], row], records=0)
    checks = [check for check in check_leaderboard(keep / "leaderboard.json") if check.policy == str(folder)]
    assert [(check.proof, check.records, check.faults) for check in checks] == [("all", 2, [])]
    with pytest.raises(ValueError, match=r"0\.jsonl: "):  # another salt
        benchmark(["unlabelled"], [ROWS[0], row], TINY, 2, split="private:" + "f" * 32)
    room = Room("unlabelled", calls=400, seed=AUDIT_SEED + 1, **seat)
    refused("this episode has not ended", find_rows, [str(folder)])
    room.close()
    Room("unlabelled", folder=folder, salt=salt, seed=AUDIT_SEED + 2, names="opaque", calls=400).close()
    refused("one row has the same condition everywhere", find_rows, [str(folder)])
    (folder / "episode-0000.jsonl").unlink()
    refused("is missing, or has been changed", find_rows, [str(folder)])
