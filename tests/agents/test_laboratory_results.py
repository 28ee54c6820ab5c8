"""Managers' results: which runs belong together, what is played, and what the page says of it."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("matplotlib")

from chemlab.agents.evaluation import laboratory, statistics
from chemlab.agents.evaluation.laboratory import (
    BASELINES,
    MEASURES,
    brief_table,
    collect_laboratories,
    laboratory_count,
    write_laboratory,
)
from chemlab.agents.evaluation.results import read_results
from chemlab.agents.player import play_laboratory
from chemlab.agents.policies import make_policies
from chemlab.agents.runs import RESULT_SEED, CurvePoint, Evaluation, Run, RunConfig, RunResult
from chemlab.cli import app
from chemlab.laboratory.core import Laboratories

runner = CliRunner()
SMALL: dict[str, Any] = {
    "env_id": "manager",
    "preset": "manager",
    "envs": 8,
    "rollout": 8,
    "steps": 128,
    "imitate": None,
    "curriculum": ["64: submit=0.5"],
    "evaluations": 1,
    "checkpoints": 1,
    "eval_episodes": 1,
    "final_episodes": 2,
}
SCRIPTED = 0.5


def write_run(path: Path, seed: int = 0, bench: str = "manager_0", finished: bool = True, **settings: Any) -> Path:
    """A run's files without checkpoints; ``settings`` are arguments."""
    run = Run(path)
    path.mkdir(parents=True)
    config = RunConfig("any", {"seed": seed, **settings}, "wurtz_dodecane", bench, ["dodecane"], "0")
    run.config_file.write_text(json.dumps(config.as_dict()))
    for step in (0, 1000):
        run.append(CurvePoint(step, step / 1000.0 + seed, 0.1, 5, 1.0))
    run.append(Evaluation(1000, 0.8, {"dodecane": 0.8}, SCRIPTED, None))
    if finished:
        means = {"dodecane": 0.8}
        result = RunResult(
            *("chemlab/LabManager-v0", "any", "maskable-ppo", seed, 1000, 600.0, 1.0, 1000),
            *(10, 0.8, means, SCRIPTED, {"dodecane": SCRIPTED}, 0.8, means),
        )
        run.result_file.write_text(json.dumps(vars(result)))
    return path


def means(score: float, **others: float) -> dict[str, dict[str, float]]:
    return {"dodecane": {**dict.fromkeys(MEASURES, 0.0), "score": score, **others}}


def stored_run(folder: Path, path: Path, score: float, scripted: float = SCRIPTED) -> dict[str, Any]:
    """A run's part of ``laboratory.json``."""
    return {
        "label": path.parent.name,
        "run": path.relative_to(folder).as_posix(),
        "seed": 0,
        "steps": 1000,
        "seconds": 600.0,
        "learned": ["manager"],
        "same_task": True,
        **laboratory._circumstances(10),
        "by_goal": means(score, purity=0.987, ticks=41.6),
        "scripted": means(scripted),
    }


def store(folder: Path, runs: Sequence[dict[str, Any]], left_out: Sequence[dict[str, Any]] = ()) -> None:
    how = laboratory._circumstances(10)
    values = {"scripted": SCRIPTED, "direct": 0.3, "hasty": 0.25, "random": -0.1}
    baselines = {name: means(value) for name, value in values.items()}
    group = {"scenario": "wurtz_dodecane", "background": "heuristic", "goals": ["dodecane"], "baselines": baselines}
    content = {**how, "groups": [{**group, **how, "runs": list(runs)}], "left_out": list(left_out)}
    (folder / "laboratory.json").write_text(json.dumps(content))


def rows_of(page: Path) -> dict[tuple[str, str], list[str]]:
    """{(benches, manager): the other cells} of the tables."""
    rows = [line.strip("| ").split(" | ") for line in page.read_text().splitlines() if line.startswith("| ")]
    return {(row[0], row[1]): row[2:] for row in rows if row[0] != "benches"}


# -- which runs -------------------------------------------------------------------------------------------------------


def test_runs_of_managers_are_told_from_others(tmp_path: Path) -> None:
    """Alone, with benches, with all of them; not benches alone, and not what is unfinished."""
    for name, bench in (("a", "manager_0"), ("b", "manager,rxn,ext"), ("c", "rxn,manager"), ("d", "rxn,ext")):
        write_run(tmp_path / name / "seed-0", bench=bench)
    write_run(tmp_path / "e" / "seed-0", bench="rxn_0")
    write_run(tmp_path / "f" / "seed-0", finished=False)
    results = read_results(tmp_path)
    assert [run.run.path.parent.name for run in results.laboratories] == ["a", "b", "c"]
    assert results.left_out == [
        "d/seed-0: not one of the paper's experiments",
        "e/seed-0: not one of the paper's experiments",
        "f/seed-0: not finished",
    ]


def test_runs_are_grouped_by_background_and_folder(tmp_path: Path) -> None:
    """Folders of one preset stay apart, whatever their runs call themselves; so do two trainers' of one name."""
    for seed in (1, 0):
        write_run(tmp_path / "w-manager_0" / "long" / f"seed-{seed}", seed, background=None)
        write_run(tmp_path / "w-manager_0" / "manager" / f"seed-{seed}", seed)
    write_run(tmp_path / "w-rllib" / "manager" / "seed-0", background="heuristic")
    write_run(tmp_path / "w-manager_0" / "safe" / "seed-0", background="pretrained")
    found = {
        (group.background, label): [one.result.seed for one in runs]
        for group in laboratory._groups(tmp_path)
        for label, runs in group.runs.items()
    }
    assert found == {
        ("heuristic", "long"): [0, 1],
        ("heuristic", "w-manager_0/manager"): [0, 1],
        ("heuristic", "w-rllib/manager"): [0],
        ("pretrained", "safe"): [0],
    }
    assert laboratory_count(tmp_path) == 6 + 2 * len(BASELINES)


def test_without_managers_nothing_is_written_or_said(tmp_path: Path) -> None:
    source, out = tmp_path / "results", tmp_path / "out"
    write_run(source / "rxn" / "seed-0", bench="rxn")
    before = sorted(source.rglob("*"))
    assert laboratory_count(source) == 0
    assert collect_laboratories(source) is None
    assert write_laboratory(source, out) is None
    assert not out.exists()
    done = runner.invoke(app, ["figures", str(source), "-o", str(out)])
    assert done.exit_code == 0, done.output
    assert "laboratory" not in done.output
    assert {path.name for path in out.iterdir()} == {"summary.md", "summary.json"}
    assert sorted(source.rglob("*")) == before
    for name in ("laboratory.md", "laboratory_curves.png"):  # of earlier results
        (out / name).write_text("old")
    write_laboratory(source, out)
    assert {path.name for path in out.iterdir()} == {"summary.md", "summary.json"}


# -- the page ---------------------------------------------------------------------------------------------------------


def test_intervals_are_over_seeds(tmp_path: Path) -> None:
    """Seeds 0.6, 0.7, 0.9: their mean, the bootstrap interval of these three numbers, and of their paired gains."""
    paths = [write_run(tmp_path / "manager" / f"seed-{seed}", seed) for seed in range(3)]
    alone = write_run(tmp_path / "alone" / "seed-0")
    scores, scripted = np.array([0.6, 0.7, 0.9]), np.array([0.5, 0.5, 0.6])
    runs = [stored_run(tmp_path, *row) for row in zip(paths, scores, scripted, strict=True)]
    runs[1] |= {"steps": 3000, "seconds": 1200.0}
    store(tmp_path, [*runs, stored_run(tmp_path, alone, 0.25)])
    written = write_laboratory(tmp_path, tmp_path / "out")
    assert written is not None
    assert written.left_out == []
    rows = rows_of(written.page)
    assert list(rows) == [
        ("heuristic", name) for name in ("manager", "alone", *(text for _, text in BASELINES.values()))
    ]
    expected = statistics.mean([scores])
    assert rows["heuristic", "manager"][0] == str(expected)
    assert expected.low < 0.7333 < expected.high
    gain = statistics.mean([scores - scripted])
    assert rows["heuristic", "manager"][1] == f"+0.200 [{gain.low:+.3f}, {gain.high:+.3f}]"
    assert rows["heuristic", "manager"][4:] == ["98.7", "0.000", "42", "3", "13", "1,000 to 3,000"]
    assert rows["heuristic", "alone"][:2] == ["0.250", "-0.250"]  # one seed has no interval
    assert rows["heuristic", "random legal actions"][:2] == ["-0.100", "-0.600"]
    assert rows["heuristic", "scripted"][:2] == ["0.500", ""]


def test_the_curves_are_those_of_all_training_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part for each scenario and background, a line for each folder with its spread, the scripted manager's."""
    for seed in (0, 1):
        write_run(tmp_path / "fast" / f"seed-{seed}", seed)
        write_run(tmp_path / "slow" / f"seed-{seed}", seed, background="pretrained")
    figures = []
    monkeypatch.setattr(laboratory, "save_figure", lambda figure, path: figures.append((figure, path.name)))
    written = write_laboratory(tmp_path, tmp_path / "out", ["svg"])
    assert written is not None
    ((figure, name),) = figures
    assert name == "laboratory_curves.svg"
    assert [axes.get_title() for axes in figure.axes] == [
        "wurtz_dodecane, benches heuristic",
        "wurtz_dodecane, benches pretrained",
    ]
    for axes, label in zip(figure.axes, ("fast", "slow"), strict=True):
        lines = {line.get_label(): line for line in axes.get_lines()}
        line = lines[f"{label} (2 runs)"]
        np.testing.assert_allclose(line.get_ydata(), np.asarray(line.get_xdata()) + 0.5)
        assert set(lines["heuristic"].get_ydata()) == {SCRIPTED}
        assert len(axes.collections) == 1  # the spread


def test_runs_that_have_not_been_played_are_said(tmp_path: Path) -> None:
    """Without a laboratory.json, and with one that is older than a run; summary.md does not list them."""
    known, fresh = (write_run(tmp_path / "results" / "manager" / f"seed-{seed}", seed) for seed in (0, 1))
    results, out = tmp_path / "results", tmp_path / "out"
    written = write_laboratory(results, out)
    assert written is not None
    assert len(written.left_out) == 2
    assert not rows_of(written.page)
    store(results, [stored_run(results, known, 0.7)])
    done = runner.invoke(app, ["figures", str(results), "-o", str(out), "--format", "png", "--format", "svg"])
    assert done.exit_code == 0, done.output
    said = re.sub(r"\s+", " ", done.output)
    assert "left out manager/seed-1: not played yet (chemlab figures --collect)" in said
    assert "seed-0: not" not in said
    page = (out / "laboratory.md").read_text()
    assert f"- {fresh.relative_to(results).as_posix()}: not played yet" in page
    assert "![laboratory_curves](laboratory_curves.png)" in page
    assert {path.name for path in out.iterdir()} == {
        *("laboratory.md", "laboratory_curves.png", "laboratory_curves.svg", "summary.md", "summary.json"),
    }
    assert "manager" not in (out / "summary.md").read_text()


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "laboratory.json").write_text("{")
    with pytest.raises(ValueError, match=r"laboratory\.json: not valid JSON"):
        write_laboratory(tmp_path, tmp_path / "out")


# -- playing ----------------------------------------------------------------------------------------------------------


def test_what_measuring_costs_and_how_often_a_manager_acts() -> None:
    """Every episode's instruments and actions are those that the laboratory itself has charged and counted."""
    labs = Laboratories("wurtz_dodecane", 4)
    played = play_laboratory(labs, make_policies("heuristic,manager=random", labs, 3), "dodecane", 3)
    charged = [labs.costs(member)["instruments"] for member in range(4)]
    assert played.measures["instruments"].tolist() == charged
    assert max(charged) > 0.0
    assert played.measures["manager_actions"].tolist() == labs.turns_had(0).tolist()
    plan = play_laboratory(labs, make_policies("heuristic,manager=hasty", labs, 3), "dodecane", 3)
    assert (plan.measures["instruments"] == 0.0).all()


def test_runs_without_checkpoints_keep_what_was_known(tmp_path: Path) -> None:
    """What cannot be played is left out, with the reason; the file's earlier numbers of it stay, as its group does."""
    known, lost = (write_run(tmp_path / "manager" / f"seed-{seed}", seed) for seed in (0, 1))
    empty = write_run(tmp_path / "other" / "seed-0")
    (empty / "checkpoints" / "best-100").mkdir(parents=True)
    store(tmp_path, [stored_run(tmp_path, known, 0.7)])
    before = json.loads((tmp_path / "laboratory.json").read_text())
    told: list[str] = []
    content = collect_laboratories(tmp_path, 3, told.append)
    assert content is not None
    assert json.loads((tmp_path / "laboratory.json").read_text()) == json.loads(json.dumps(content))
    assert content["groups"] == before["groups"]  # 10 episodes, not 3
    assert len(told) == laboratory_count(tmp_path)
    assert {one["run"]: (one["kept"], one["reason"].partition(" (")[0]) for one in content["left_out"]} == {
        "manager/seed-0": (True, "its checkpoints are missing"),
        "manager/seed-1": (False, "its checkpoints are missing"),
        "other/seed-0": (False, "its checkpoint has no manager"),
    }
    written = write_laboratory(tmp_path, tmp_path / "out")
    assert written is not None
    assert len(written.left_out) == 3
    assert written.left_out[0].endswith("; the table has what was played earlier")
    assert str(lost.relative_to(tmp_path)) in written.left_out[1]
    assert rows_of(written.page)["heuristic", "manager"][0] == "0.700"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results with a run of a manager with benches that are not the default ones."""
    pytest.importorskip("stable_baselines3")
    from chemlab.agents.training.arguments import TrainArguments
    from chemlab.agents.training.learn import train

    folder = tmp_path_factory.mktemp("results")
    train(TrainArguments.of({**SMALL, "background": "hasty"}), folder / "wurtz_dodecane-manager_0" / "tiny" / "seed-0")
    return folder


def test_a_real_run_from_training_to_the_page(trained: Path, tmp_path: Path) -> None:
    """Two episodes from the seeds that training reported are the two that it reported; the page has them."""
    content = collect_laboratories(trained, episodes=2)
    assert content is not None
    assert content["left_out"] == []
    assert (content["seed"], content["episodes_per_goal"]) == (RESULT_SEED, 2)
    (group,) = content["groups"]
    (run,) = group["runs"]
    result = Run(trained / run["run"]).result()
    assert result is not None
    assert run["by_goal"]["dodecane"]["score"] == pytest.approx(result.mean, abs=1e-12)
    assert run["scripted"] == group["baselines"]["scripted"]
    assert run["scripted"]["dodecane"]["score"] == pytest.approx(result.heuristic_mean, abs=1e-12)
    assert (run["label"], run["learned"], run["same_task"]) == ("tiny", ["manager"], True)
    assert all(set(one["dodecane"]) == set(MEASURES) for one in (run["by_goal"], *group["baselines"].values()))
    done = runner.invoke(app, ["figures", str(trained), "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "left out" not in done.output
    row = rows_of(tmp_path / "laboratory.md")["hasty", "tiny"]
    assert float(row[0]) == pytest.approx(result.mean, abs=6e-4)
    assert row[-1] == "128"
    assert (tmp_path / "laboratory_curves.png").exists()


def test_a_lost_run_stands_beside_one_that_was_played_again(trained: Path, tmp_path: Path) -> None:
    """Its numbers are older: the page says so. A run that is no longer there is gone from the file."""
    folder = tmp_path / "results"
    shutil.copytree(trained, folder)
    first = folder / "wurtz_dodecane-manager_0" / "tiny" / "seed-0"
    second = first.with_name("seed-1")
    shutil.copytree(first, second)
    for path in (first, second):
        result = json.loads((path / "result.json").read_text())
        (path / "result.json").write_text(json.dumps({**result, "seed": int(path.name[-1])}))
    collect_laboratories(folder, episodes=2)
    shutil.rmtree(first / "checkpoints")
    content = collect_laboratories(folder, episodes=1)
    assert content is not None
    assert [(one["run"][-1], one["kept"]) for one in content["left_out"]] == [("0", True)]
    ((kept, again),) = (group["runs"] for group in content["groups"])
    assert (kept["episodes_per_goal"], again["episodes_per_goal"]) == (2, 1)
    written = write_laboratory(folder, tmp_path / "out")
    assert written is not None
    assert "seed-0: played earlier than the others" in written.page.read_text()
    shutil.rmtree(first)
    content = collect_laboratories(folder, episodes=1)
    assert content is not None
    assert [run["run"][-1] for run in content["groups"][0]["runs"]] == ["1"]


def test_benches_that_learned_play_with_the_scripted_manager_too(tmp_path: Path) -> None:
    """A joint run is compared over its own benches, not over the background's."""
    pytest.importorskip("sb3_contrib")
    from chemlab.agents.training.arguments import JointArguments
    from chemlab.agents.training.joint import train_together

    small = {"envs": 4, "rollout": 12, "steps": 200, "batch_size": 32, "epochs": 1, "evaluations": 1}
    path = tmp_path / "joint" / "seed-0"
    train_together(JointArguments(roles=("manager", "dit"), eval_episodes=1, final_episodes=2, **small), path)
    content = collect_laboratories(tmp_path, episodes=2)
    assert content is not None
    (group,) = content["groups"]
    (run,) = group["runs"]
    result = Run(path).result()
    assert result is not None
    assert run["learned"] == ["dit", "manager"]
    assert run["same_task"] is True
    assert run["by_goal"]["dodecane"]["score"] == pytest.approx(result.mean, abs=1e-12)
    assert group["baselines"]["scripted"]["dodecane"]["score"] == pytest.approx(result.heuristic_mean, abs=1e-12)
    # 200 turns teach nobody to distil: what its own benches come to with the scripted manager is far less.
    assert run["scripted"]["dodecane"]["score"] < 0.5 * group["baselines"]["scripted"]["dodecane"]["score"]
    written = write_laboratory(tmp_path, tmp_path / "out")
    assert written is not None
    assert ("heuristic; learned: dit", "joint") in rows_of(written.page)


def test_a_brief_table_is_of_shipped_scenarios_or_of_others(tmp_path: Path) -> None:
    path = write_run(tmp_path / "manager" / "seed-0")
    store(tmp_path, [stored_run(tmp_path, path, 0.75)])
    head, rule, learned, *others = brief_table(tmp_path, shipped=True)
    cells = [cell.strip() for cell in learned.split("|")[1:-1]]
    assert cells[:4] == ["`wurtz_dodecane`", "heuristic", "manager", "0.750"]
    assert len(others) == 2
    assert {line.count("|") for line in (head, rule, learned, *others)} == {9}
    assert brief_table(tmp_path, shipped=False) == [head, rule]
    with pytest.raises(ValueError, match="--collect makes it"):
        brief_table(tmp_path / "manager", shipped=True)
