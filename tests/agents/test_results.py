"""Training runs as evaluation reads them: runs together, curves, the page and its command."""

import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers import command
from run_files import HEURISTIC, write_run
from scipy import stats

from chemlab.agents.evaluate.curves import algorithm_style, average_curves
from chemlab.agents.evaluate.page import write_page
from chemlab.agents.evaluate.results import cells_of, cells_table, group_runs, read_runs
from studies.paper.chemgymrl.measures import training_end


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Four runs of one bench that differ in their seed, one that was trained in another way, one that has not ended."""
    folder = tmp_path / "runs"
    for seed, value in enumerate((0.4, 0.5, 0.6, 0.7)):
        returns = {"a": value, "b": value + 0.1 / 3.0}
        evaluations = {500: 0.1, 1000: value}
        write_run(folder / "x" / f"seed-{seed}", "lab", "rxn", returns, label="ppo", seed=seed, evaluations=evaluations)
    write_run(folder / "y", "lab", "rxn", {"a": 0.9, "b": 0.9}, label="ppo", envs=99, curriculum=["64: submit=0.5"])
    write_run(folder / "z", "lab", "rxn", {"a": 0.9, "b": 0.9}, label="ppo", finished=False)
    return folder


def test_runs_of_before_0_3_are_read(runs: Path) -> None:
    """Scripted scores had another name."""
    path = runs / "x" / "seed-0"
    expected = read_runs(path)[0]
    for file in (path / "result.json", path / "evaluations.jsonl"):
        file.write_text(file.read_text().replace('"scripted_', '"heuristic_'))
    (found,) = read_runs(path)
    assert (found.result, found.evaluations) == (expected.result, expected.evaluations)


def test_runs_that_differ_in_their_seed_are_together(runs: Path) -> None:
    """Other settings are a row of their own; the table has mean, interval, best, last and scripted."""
    cells, left_out = cells_of(group_runs(read_runs(runs)))
    assert left_out == ["z: not finished"]
    ((title, labels),) = cells.items()
    assert {key: [run.name for run in one.runs] for key, one in labels.items() if key != "ppo"} == {"ppo (y)": ["y"]}
    cell = labels["ppo"]
    assert title == "lab, rxn, 2 goals"
    assert [run.finished.seed for run in cell.runs] == [0, 1, 2, 3]
    means = np.array([0.4, 0.5, 0.6, 0.7]) + 0.05 / 3.0
    np.testing.assert_allclose(cell.means(), means)
    np.testing.assert_allclose(cell.relative(), cell.by_goal() / HEURISTIC)
    assert training_end(cell, np.mean) == pytest.approx(0.4)
    _, _, line = cells_table([cell])
    row = [text.strip() for text in line.strip("|").split("|")]
    assert row[:4] == ["lab, rxn, 2 goals", "PPO", "4", "1,000"]
    ends = stats.ttest_1samp(means, 0.0).confidence_interval(0.95)
    assert (row[4], row[6:9]) == (f"0.567 [{ends.low:.3f}, {ends.high:.3f}]", ["0.717", "0.467", "0.500"])
    # Of 8 pairs with the scripted policy: goal a 0 + 1/2 + 1 + 1, goal b 0 + 3 x 1.
    assert row[9].startswith(f"{(2.5 + 3.0) / 8.0:.2f} [")
    # A run plays both goals: these are not twice as many runs, so the interval is that of four.
    middle, ends = 5.5 / 8.0, row[9].partition("[")[2].rstrip("]").split(", ")
    assert float(ends[1]) - float(ends[0]) > 2 * 1.96 * math.sqrt(middle * (1.0 - middle) / 3.0 / (4 * 4) * 4) * 0.8
    alone = cells_table([labels["ppo (y)"]])[2]
    assert "| PPO (y) |" in alone
    assert "[" not in alone


def test_a_seed_counts_once(runs: Path) -> None:
    """A repetition with the same seed, or a copy, is no further sample."""
    write_run(runs / "y2", "lab", "rxn", {"a": 0.9, "b": 0.9}, label="a2c")
    shutil.copytree(runs / "y2", runs / "y3")
    cells, left_out = cells_of(group_runs(read_runs(runs)))
    ((_, labels),) = cells.items()
    assert [run.name for run in labels["a2c"].runs] == ["y2"]
    assert "y3: has the seed of y2, 0, and equal settings" in left_out


def test_of_equally_many_runs_the_longer_ones_have_the_label(tmp_path: Path) -> None:
    for seed in (0, 1):
        write_run(tmp_path / "short" / f"seed-{seed}", "lab", "rxn", {"a": 0.5}, seed=seed)
        write_run(tmp_path / "long" / f"seed-{seed}", "lab", "rxn", {"a": 0.5}, seed=seed, steps=9000)
    write_run(tmp_path / "short" / "seed-2", "lab", "rxn", {"a": 0.5}, seed=2, envs=1)
    (labels,) = cells_of(group_runs(read_runs(tmp_path)))[0].values()
    steps = {label: (cell.steps, len(cell.runs)) for label, cell in labels.items()}
    assert steps == {"any": (9000, 2), "any (short)": (1000, 2), "any (short/seed-2)": (1000, 1)}


def test_learning_curves_against_closed_forms() -> None:
    """Two straight curves of other lengths: the mean on what they share; deviations of runs and of single returns."""
    first, second = np.array([[0, 0.0, 0.5], [1000, 1.0, 0.5]]), np.array([[100, 2.1, 0.5], [800, 2.8, 0.5]])
    steps, mean, between, single = average_curves([first, second])
    assert (steps[0], steps[-1]) == (100.0, 800.0)
    np.testing.assert_allclose(mean, steps / 1000.0 + 1.0)
    np.testing.assert_allclose(between, math.sqrt(2.0))  # of the two values x and x + 2
    np.testing.assert_allclose(single, math.sqrt(0.5**2 + 1.0**2))
    assert np.isnan(average_curves([first])[2]).all()
    assert average_curves([np.zeros((0, 3))]) is None


def test_variants_have_looks_of_their_own() -> None:
    labels = ["ppo", "a2c", "sac", "td3", "ppo-entropy", "ppo-xl", "sac-cool", "td3-wide"]
    looks = [algorithm_style(label, labels) for label in labels]
    assert len({look["color"] for look in looks}) == len(labels)
    assert len({str(look["linestyle"]) for look in looks[4:] if look is not looks[5]}) == 3


def test_the_page_of_runs(runs: Path, tmp_path: Path) -> None:
    """Also of managers; nothing is written into the runs."""
    pytest.importorskip("matplotlib")
    write_run(runs / "m" / "seed-0", "lab", "manager_0", {"a": 0.25}, label="ippo")
    before = sorted(runs.rglob("*"))
    out = tmp_path / "out"
    said = command("plot", "runs", runs, "-o", out, "--format", "svg", "--format", "png")
    assert "left out z: not finished" in said
    assert sorted(runs.rglob("*")) == before
    assert {path.name for path in out.iterdir()} == {"runs.md", "runs_curves.svg", "runs_curves.png"}
    page = (out / "runs.md").read_text()
    assert "- z: not finished" in page
    assert "| lab, manager_0, goal a | ippo | 1 | 1,000 | 0.250 |" in page


def test_names_of_runs_are_text_on_pages(tmp_path: Path) -> None:
    """Runs may be of other people, and readers of Markdown follow its HTML and links."""
    pytest.importorskip("matplotlib")
    for seed, bench in enumerate(("rxn", "manager", "rxn")):
        write_run(tmp_path / "[a](b)" / str(seed), "<i>lab", bench, {"a": 1.0}, label="x\n\n[x]: y", envs=seed + 1)
    page, _ = write_page(tmp_path, tmp_path / "pages")
    text = page.read_text()
    for shown in ("&lt;i>lab", "[a]\\(b)"):
        assert shown in text
    assert not re.search(r"<|^\[|[^!]\[a\]\(", text, re.MULTILINE)


def test_mistakes_are_said_before_anything_is_made(runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("in the way")
    before = [path for path in sorted(tmp_path.rglob("*")) if path.is_file()]
    for arguments, words in (
        ("nothing", "no such folder of results"),
        ("runs --format bmp2", "--format: must be one of png, svg, pdf; given bmp2"),
        ("runs --out file/pages", "pages: cannot write there"),
    ):
        assert words in command("plot", "runs", *arguments.split(), code=2)
    assert [path for path in sorted(tmp_path.rglob("*")) if path.is_file()] == before
