"""Managers' results: which runs belong together, what is played, and what the page says of it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

pytest.importorskip("matplotlib")

import run_files

from chemlab import __version__
from chemlab.agents.episodes import play_laboratory
from chemlab.agents.policies import make_policies
from chemlab.agents.runs import RESULT_SEED, Run
from chemlab.lab.engine import Laboratories
from studies.paper import managers
from studies.paper.managers import BASELINES, MEASURES, collect, write_laboratory
from studies.paper.tables import read_runs, read_table, write_runs, write_table

HOW = {"episodes": 10, "seed": RESULT_SEED, "chemlab": __version__}


def write_run(path: Path, seed: int = 0, bench: str = "manager_0", score: float = 0.8, **more: Any) -> Path:
    """A run's files without checkpoints; ``more`` are its result's and arguments."""
    curve = [(step, step / 1000.0 + seed, 0.1) for step in (0, 1000)]
    more = {"evaluations": {1000: 0.8}, "seconds": 600.0, "curve": curve, "label": path.parent.name, **more}
    return run_files.write_run(path, "wurtz_dodecane", bench, {"dodecane": score}, seed=seed, **more)


def row(policy: str, score: float, run: str = "", background: str = "scripted", **others: Any) -> dict[str, Any]:
    """A row of ``managers.csv``."""
    where = {"scenario": "wurtz_dodecane", "background": background, "policy": policy, "run": run, "goal": "dodecane"}
    return {**where, **HOW, "same_task": True, **dict.fromkeys(MEASURES, 0.0), "score": score, **others}


def store(folder: Path, played: Mapping[str, float], *more: dict[str, Any]) -> None:
    """Make a folder of runs one of tables, in which the runs by name and the baselines have been played."""
    write_runs(folder, read_runs(folder))
    values = {"scripted": run_files.HEURISTIC, "scripted:no-extraction": 0.3, "plan": 0.25, "random": -0.1}
    rows = [row(name, value) for name, value in values.items()]
    rows += [row("learned", score, name, purity=0.987, ticks=41.6) for name, score in played.items()]
    write_table(folder / "managers.csv", managers._COLUMNS, [*rows, *more])


def stored(folder: Path) -> list[dict[str, str]]:
    return read_table(folder / "managers.csv", managers._COLUMNS)


def rows_of(page: Path) -> dict[tuple[str, str], list[str]]:
    """{(benches, manager): the other cells} of the tables."""
    rows = [line.strip("| ").split(" | ") for line in page.read_text().splitlines() if line.startswith("| ")]
    return {(row[0], row[1]): row[2:] for row in rows if row[0] != "benches"}


def labels(folder: Path) -> dict[tuple[str, str], list[int]]:
    """{(background, label): seeds} of a folder's managers."""
    groups = managers._groups(read_runs(folder))
    return {(g.background, key): [run.finished.seed for run in runs] for g in groups for key, runs in g.labels.items()}


def test_managers_are_grouped_by_scenario_background_and_settings(tmp_path: Path) -> None:
    """Managers alone, with benches, with all of them; not benches alone, and not what is unfinished."""
    for name, bench in (("a", "manager_0"), ("b", "manager,rxn,ext"), ("c", "rxn,manager"), ("d", "rxn,ext")):
        write_run(tmp_path / "who" / name / "seed-0", bench=bench, label=name)
    write_run(tmp_path / "who" / "e" / "seed-0", bench="rxn_0")
    write_run(tmp_path / "who" / "f" / "seed-0", finished=False)
    assert labels(tmp_path / "who") == {("scripted", name): [0] for name in "abc"}
    where = tmp_path / "where"
    for seed in (1, 0):
        write_run(where / "manager" / f"seed-{seed}", seed, label="ippo", begin_from=f"first/seed-{seed}")
    write_run(where / "clone" / "seed-0", label="ippo", bc="scripted")
    write_run(where / "safe" / "seed-0", background="pretrained", label="ippo")
    assert labels(where) == {
        ("scripted", "ippo"): [0, 1],
        ("scripted", "ippo (clone)"): [0],
        ("pretrained", "ippo"): [0],
    }
    write_runs(tmp_path / "tables", read_runs(where))
    assert labels(tmp_path / "tables") == labels(where)


def test_without_managers_nothing_is_written(tmp_path: Path) -> None:
    source, tables, out = tmp_path / "results", tmp_path / "tables", tmp_path / "out"
    write_run(source / "rxn" / "seed-0", bench="rxn")
    assert collect(source, tables) == []
    assert not (tables / "managers.csv").exists()
    assert write_laboratory(source, out) == (None, [])
    assert not out.exists()


def test_intervals_are_over_seeds(tmp_path: Path) -> None:
    """Seeds 0.6, 0.7, 0.9: their mean, Student's interval of these three numbers, and of their paired gains."""
    scores, scripted = np.array([0.6, 0.7, 0.9]), np.array([0.5, 0.5, 0.6])
    for seed in range(3):
        path = tmp_path / "manager" / f"seed-{seed}"
        write_run(path, seed, score=0.8 - 0.3 * (seed == 2), seconds=1200.0 if seed == 1 else 600.0)
        if seed == 1:  # the last rollout of this run was longer
            result = path / "result.json"
            result.write_text(result.read_text().replace('"steps": 1000', '"steps": 3000'))
    write_run(tmp_path / "alone" / "seed-0")
    names = [f"manager/seed-{seed}" for seed in range(3)]
    beside = [row("scripted", value, name) for name, value in zip(names, scripted, strict=True)]
    store(tmp_path, {**dict(zip(names, scores, strict=True)), "alone/seed-0": 0.25}, *beside)
    page, left_out = write_laboratory(tmp_path, tmp_path / "out")
    assert left_out == []
    rows = rows_of(page)
    names = ("alone", "manager", *(text for _, text in BASELINES.values()))
    assert list(rows) == [("scripted", name) for name in names]
    expected = stats.ttest_1samp(scores, 0.0).confidence_interval(0.95)
    assert rows["scripted", "manager"][0] == f"0.733 [{expected.low:.3f}, {expected.high:.3f}]"
    gain = stats.ttest_1samp(scores - scripted, 0.0).confidence_interval(0.95)
    assert rows["scripted", "manager"][1] == f"+0.200 [{gain.low:+.3f}, {gain.high:+.3f}]"
    assert rows["scripted", "manager"][2] == "0.600"  # last checkpoints: 0.7, 0.7, 0.4
    assert rows["scripted", "manager"][5:] == ["98.7", "0.000", "42", "3", "13", "1,000 to 3,000"]
    assert rows["scripted", "alone"][:3] == ["0.250", "-0.250", "0.700"]  # one seed has no interval
    assert rows["scripted", "random legal actions"][:3] == ["-0.100", "-0.600", ""]
    assert rows["scripted", "scripted"][:2] == ["0.500", ""]


def test_runs_that_have_not_been_played_are_said(tmp_path: Path) -> None:
    """Of runs' folders, and of tables that are older than a run."""
    results, out = tmp_path / "results", tmp_path / "out"
    for seed in (0, 1):
        write_run(results / "manager" / f"seed-{seed}", seed)
    page, left_out = write_laboratory(results, out)
    assert len(left_out) == 2
    assert not rows_of(page)
    store(results, {"manager/seed-0": 0.7})
    page, left_out = write_laboratory(results, out)
    assert left_out == ["manager/seed-1: not played yet (python -m studies.paper --collect RUNS)"]
    page = page.read_text()
    assert f"- {left_out[0]}" in page
    assert "![laboratory_curves](laboratory_curves.png)" in page
    assert {path.name for path in out.iterdir()} == {"laboratory.md", "laboratory_curves.png"}


def test_what_measuring_costs_and_how_often_a_manager_acts() -> None:
    """Every episode's instruments and actions are those that the laboratory itself has charged and counted."""
    labs = Laboratories("wurtz_dodecane", 4)
    played = play_laboratory(labs, make_policies("scripted,manager=random", labs, 3), "dodecane", 3)
    charged = [labs.costs(member)["instruments"] for member in range(4)]
    assert played.measures["instruments"].tolist() == charged
    assert max(charged) > 0.0
    assert played.measures["manager_actions"].tolist() == labs.roles[0].turns_had.tolist()
    plan = play_laboratory(labs, make_policies("scripted,manager=plan", labs, 3), "dodecane", 3)
    assert (plan.measures["instruments"] == 0.0).all()


def test_runs_without_checkpoints_keep_what_was_known(tmp_path: Path) -> None:
    """What cannot be played is told, with the reason; the table's earlier rows of it stay, as all of its group do."""
    runs, tables = tmp_path / "runs", tmp_path / "tables"
    for seed in (0, 1):
        write_run(runs / "manager" / f"seed-{seed}", seed)
    write_runs(tables, read_runs(runs))
    (write_run(runs / "other" / "seed-0") / "checkpoints" / "best-100").mkdir(parents=True)
    store(tables, {"manager/seed-0": 0.7})
    before = stored(tables)
    told: list[str] = []
    said = collect(runs, tables, 3, told.append)
    assert stored(tables) == before  # 10 episodes, not 3
    assert len(told) == len(BASELINES) + 3
    other = f"policy: {runs / 'other' / 'seed-0'}: was trained by a version with other learners; train it again"
    assert [line.partition(" (")[0] for line in said] == [
        *(f"manager/seed-{seed}: its checkpoints are missing" for seed in (0, 1)),
        f"other/seed-0: {other}",
    ]
    assert [line.endswith("; the table has what was played earlier") for line in said] == [True, False, False]
    assert [run.name for run in read_runs(tables)] == ["manager/seed-0", "manager/seed-1", "other/seed-0"]
    page, left_out = write_laboratory(tables, tmp_path / "out")
    assert len(left_out) == 2
    assert rows_of(page)["scripted", "manager"][0] == "0.700"


def test_a_new_baseline_is_played_over_tables_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that the table does not have is played, one that is gone is dropped, all else stays as it was."""
    write_run(tmp_path / "manager" / "seed-0")
    store(tmp_path, {"manager/seed-0": 0.7})
    before = {(r["policy"], r["run"]): r for r in stored(tmp_path)}
    swapped = {name: value for name, value in BASELINES.items() if name != "plan"}
    swapped |= {"new": ("scripted:no-extraction", "new"), "none": ("no_such_policy", "not there")}
    monkeypatch.setattr(managers, "BASELINES", swapped)
    (said,) = collect(tmp_path, tmp_path, 2)
    assert said.startswith("wurtz_dodecane, none: ")
    after = {(r["policy"], r["run"]): r for r in stored(tmp_path)}
    assert after.keys() == before.keys() - {("plan", "")} | {("new", "")}
    assert all(after[key] == before[key] for key in after if key != ("new", ""))
    labs = Laboratories("wurtz_dodecane", 2)
    policies = make_policies("scripted,manager=scripted:no-extraction", labs)
    played = play_laboratory(labs, policies, "dodecane", RESULT_SEED)
    assert float(after["new", ""]["score"]) == played.returns.mean()


def test_a_real_run_from_training_to_the_page(tmp_path: Path) -> None:
    """Two episodes from the seeds that training reported; a joint run is compared over its own benches."""
    path, tables = tmp_path / "runs" / "joint" / "seed-0", tmp_path / "tables"
    own: dict[str, Any] = {"roles": ("manager", "dit"), "background": "pretrained-isolated", "practice": 0.0}
    run_files.trained(path, algo="ippo", steps=200, epochs=1, final_episodes=2, **own)
    assert collect(tmp_path / "runs", tables, episodes=2) == []
    rows = {(row["policy"], row["run"]): row for row in stored(tables)}
    own_rows = [("learned", "joint/seed-0"), ("scripted", "joint/seed-0")]
    assert list(rows) == [*((name, "") for name in BASELINES), *own_rows]
    assert [rows["learned", "joint/seed-0"][key] for key in ("seed", "episodes")] == [str(RESULT_SEED), "2"]
    assert {row["same_task"] for row in rows.values()} == {"True"}
    scores = {key: float(row["score"]) for key, row in rows.items()}
    result = Run(path).result()
    assert scores["learned", "joint/seed-0"] == pytest.approx(result.mean, abs=1e-12)
    labs = Laboratories("wurtz_dodecane", 2)
    beside = make_policies("pretrained-isolated,manager=scripted,dit=scripted", labs)
    assert play_laboratory(labs, beside, "dodecane", RESULT_SEED).returns.mean() == pytest.approx(result.scripted_mean)
    # 200 turns teach nobody to distil: what its own benches come to with the scripted manager is far less.
    assert scores["scripted", "joint/seed-0"] < 0.5 * scores["scripted", ""]
    assert write_laboratory(tables, tmp_path)[1] == []
    cells = rows_of(tmp_path / "laboratory.md")["pretrained-isolated; learned: dit", "ippo"]
    gain = scores["learned", "joint/seed-0"] - scores["scripted", "joint/seed-0"]
    assert [float(cells[i]) for i in range(3)] == pytest.approx([result.mean, gain, result.last_mean], abs=6e-4)
    assert cells[-1] == str(result.steps)
    assert (tmp_path / "laboratory_curves.png").exists()
