"""The paper's results: which runs belong to it, what is drawn, what is said of its statements."""

import itertools
import json
import math
import re
import shutil
from collections import Counter
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import run_files
from helpers import refused
from run_files import HEURISTIC

from chemlab.agents.train.sweep import plan
from chemlab.config.loading import load_scenario

pytest.importorskip("matplotlib")

from chemlab.render.figure import SETTINGS
from studies.paper import __main__ as published
from studies.paper.chemgymrl import results as module
from studies.paper.chemgymrl import traces
from studies.paper.chemgymrl.figures import FIGURES, write_figures
from studies.paper.chemgymrl.measures import MEASURES
from studies.paper.chemgymrl.page import write_page
from studies.paper.chemgymrl.results import (
    EXPERIMENTS,
    TRACE_COLUMNS,
    TRACE_FILE,
    Results,
    experiment_of,
    read_results,
    source_of,
)
from studies.paper.chemgymrl.statements import Claim, Finding, Reference, compare_with_paper, load_claims
from studies.paper.tables import read_runs, write_runs, write_table

ROOT = Path(published.__file__).parents[2]


@cache
def _now(experiment: str) -> str:
    """The fingerprint of the experiment's bench."""
    return EXPERIMENTS[experiment].fingerprint


def write_run(
    folder: Path, experiment: str, label: str, seed: int, relative: float | Mapping[str, float] = 1.0, **more: Any
) -> Path:
    """A run of an experiment; ``relative`` to the scripted policy."""
    spec = EXPERIMENTS[experiment]
    ratios = relative if isinstance(relative, Mapping) else dict.fromkeys(spec.goals, relative)
    returns = {goal: HEURISTIC * ratios.get(goal, 0.0) for goal in spec.goals}
    path = folder / experiment / label / f"seed-{seed}"
    more = {"fingerprint": _now(experiment), **more}
    return run_files.write_run(path, spec.scenario, spec.bench, returns, label=label, seed=seed, **more)


def mean_actions(label: str, goal: str) -> list[list[float]]:
    """For E all of A, B and C, and TD3 D as well; for I C comes in the fifth step, but A2C's with the others."""
    first = [0.1, 0.2, 1.0, 1.0, 1.0, float(label == "td3")]
    if goal != "I":
        return [first] * 20
    late = [[0.1, 0.2, 1.0, 1.0, 0.0, 1.0]] * 4 + [[0.1, 0.2, 0.0, 0.0, 1.0, 0.0]] * 16
    return [[0.1, 0.2, 1.0, 1.0, 1.0, 1.0]] * 20 if label == "a2c" else late


SEQUENCES = {
    "wurtz_ext": ["add diethyl_ether to EV, 0.05 L"] * 7
    + ["settle, 2 units of settling time", "drain EV -> B1, 16 % of the height"],
    "wurtz_dit": ["heat DV, 50 kJ"] * 7 + ["pour DV -> B1, 20 %"],
}


def sequence(experiment: str, label: str) -> list[int]:
    """Few actions, of which the last ends the experiment; DQN's are many and do not."""
    names = EXPERIMENTS[experiment].action_names
    return (
        [0, 1, 2, 3, 4] * 10 if label == "dqn" else [names.index(n) for n in SEQUENCES[experiment]] + [len(names) - 1]
    )


def write_traces(folder: Path, **changed: Any) -> None:
    """Traces of every algorithm's best run: made up, in the shape that collecting gives them; ``changed`` cells."""
    rows = []
    results = read_results(folder)
    for key, spec in EXPERIMENTS.items():
        for label in ("scripted", "random", *spec.algorithms):
            cell = results.cell(key, label)
            run, step = ("", "") if cell is None else source_of(cell)
            for goal, case in itertools.product(
                spec.goals, ("with NaCl", "without NaCl") if spec.bench == "dit" else ("",)
            ):
                actions: Any = mean_actions(label, goal) if spec.bench == "rxn" else sequence(key, label)
                best = "" if spec.bench == "rxn" else 0.5
                cells = (key, label, _now(key), run, step, goal, case, 2, 0.5, best, json.dumps(actions))
                rows.append({**dict(zip(TRACE_COLUMNS, cells, strict=True)), **changed})
    write_table(folder / TRACE_FILE, TRACE_COLUMNS, rows)


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two runs of everything, and traces."""
    folder = tmp_path_factory.mktemp("results")
    for key, spec in EXPERIMENTS.items():
        for label, seed in itertools.product(spec.algorithms, (0, 1)):
            write_run(folder, key, label, seed, 1.0 + 0.1 * seed)
    write_traces(folder)
    return folder


def test_runs_find_their_cells(tmp_path: Path) -> None:
    """The paper's have its starting states; of runs that differ in more than the seed most count, as everywhere."""
    for seed in (0, 1):
        write_run(tmp_path / "a", "wurtz_rxn", "ppo", seed)
    write_run(tmp_path / "b", "wurtz_rxn", "ppo", 0, steps=5000)
    write_run(tmp_path / "b", "wurtz_rxn", "a2c", 0, starts="lab")
    results = read_results(tmp_path)
    cell: Any = results.cell("wurtz_rxn", "ppo")
    assert [run.result.seed for run in cell.runs] == [0, 1]
    assert results.missing("wurtz_rxn") == ["a2c", "sac", "td3"]
    assert [line.partition(":")[0] for line in sorted(results.left_out)] == [
        f"b/wurtz_rxn/{label}/seed-0" for label in ("a2c", "ppo")
    ]


def drawn(folder: Path, stem: str) -> Any:
    """A figure of a folder's results."""
    import matplotlib

    spec = next(spec for spec in FIGURES if spec.stem == stem)
    with matplotlib.rc_context(SETTINGS):
        return spec.draw(read_results(folder))


def lines_of(axes: Any) -> dict[str, Any]:
    """{label: y of the line}."""
    return {line.get_label(): np.asarray(line.get_ydata()) for line in axes.get_lines()}


def test_radar_shows_relative_returns(tmp_path: Path) -> None:
    """(a) is the best run, (b) the mean over runs; below 0 is drawn as 0; the ring of the heuristic is 1."""
    goals = load_scenario("fictitious").goals
    write_run(tmp_path, "fictitious_rxn", "ppo", 0, dict(zip(goals, (1.0, 0.8, 0.6, 0.4, -0.5), strict=True)))
    write_run(tmp_path, "fictitious_rxn", "ppo", 1, dict(zip(goals, (1.2, 1.0, 0.8, 0.6, 0.1), strict=True)))
    figure = drawn(tmp_path, "figure_07_fictitious_rxn_goals").figure
    best, mean = (lines_of(axes) for axes in figure.axes)
    np.testing.assert_allclose(best["PPO (2 runs)"], [1.2, 1.0, 0.8, 0.6, 0.1, 1.2])
    np.testing.assert_allclose(mean["PPO (2 runs)"], [1.1, 0.9, 0.7, 0.5, 0.0, 1.1], atol=1e-12)
    assert (best["scripted"] == 1.0).all()


def test_curves_have_the_papers_bands_and_the_heuristic(tmp_path: Path) -> None:
    """A fifth of the deviation of returns for RxN, the deviation between runs elsewhere; none for a single run."""
    for key in ("wurtz_rxn", "wurtz_ext"):
        for seed in (0, 1):
            write_run(tmp_path, key, "ppo", seed, curve=[(0, 1.0 + 2.0 * seed, 0.5), (10, 1.0 + 2.0 * seed, 0.5)])
    write_run(tmp_path, "wurtz_ext", "a2c", 0)
    for stem, half in (
        ("figure_06_wurtz_rxn_curves", math.sqrt(0.5**2 + 1.0) / 5.0),
        ("figure_10_wurtz_ext_curves", math.sqrt(2.0)),
    ):
        found = drawn(tmp_path, stem)
        axes = found.figure.axes[0]
        assert (lines_of(axes)["scripted"] == HEURISTIC).all()
        np.testing.assert_allclose(lines_of(axes)["PPO (2 runs)"], 2.0)
        assert len(axes.collections) == 1  # the band of PPO; one run of A2C has none
        extent = axes.collections[0].get_paths()[0].get_extents()
        assert (extent.y0, extent.y1) == pytest.approx((2.0 - half, 2.0 + half))
    assert "One run has no spread: A2C" in " ".join(text.get_text() for text in found.figure.texts)
    assert "DQN" in found.missing[0]


@pytest.mark.parametrize("stem", [spec.stem for spec in FIGURES])
def test_no_text_overlaps_or_is_cut(full: Path, stem: str) -> None:
    """Every text stands within the picture and on no other text."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    figure = drawn(full, stem).figure
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    boxes = []
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip():
            box = text.get_window_extent(renderer)
            if box.width > 0 and _is_drawn(text, figure):
                boxes.append((text.get_text(), box))
    assert len(boxes) > 5
    for text, box in boxes:
        assert min(box.x0, box.y0) >= 0.0, text
        assert (box.x1 <= figure.bbox.x1, box.y1 <= figure.bbox.y1) == (True, True), text
    for (a, first), (b, second) in itertools.combinations(boxes, 2):
        width = min(first.x1, second.x1) - max(first.x0, second.x0)
        height = min(first.y1, second.y1) - max(first.y0, second.y0)
        assert width <= 1.0 or height <= 1.0, (a, b)


def _is_drawn(text: Any, figure: Any) -> bool:
    """Tick labels of hidden ticks and axes have text, too."""
    for axes in figure.axes:
        if not axes.axison and text.axes is axes:
            return text in axes.texts
        for axis in (axes.xaxis, axes.yaxis):
            ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
            shown = {id(tick) for tick in axis._update_ticks()}
            for tick in ticks:
                if text in (tick.label1, tick.label2):
                    return id(tick) in shown
            if text is axis.get_offset_text():
                return bool(text.get_text())
    return True


def findings(results: Results) -> dict[tuple[int, str], Finding]:
    """What is found of every statement, by figure and words."""
    return {(claim.figure, claim.says): finding for claim, finding in compare_with_paper(results)}


def test_statements_are_whole() -> None:
    """Every figure has some, and every test names measures, algorithms, goals, reagents or cases that there are."""
    claims = load_claims()
    assert [claim.figure for claim in claims] == sorted(claim.figure for claim in claims)
    assert {claim.figure for claim in claims} == {spec.number for spec in FIGURES}
    assert len({(claim.figure, claim.says) for claim in claims}) == len(claims) == 43
    for claim in claims:
        spec = EXPERIMENTS[claim.experiment]
        policies = {*spec.algorithms, "scripted", "random"}
        values = {*spec.goals, *"ABCD", "with NaCl", "without NaCl"}
        for test in claim.tests:
            right = test.right if isinstance(test.right, Reference) else Reference()
            assert {test.left, right.measure or test.left, test.beside or test.left} <= MEASURES.keys()
            assert {*test.of, *right.of} <= policies
            assert {*test.only, *test.without, *(test.which if isinstance(test.which, tuple) else ())} <= values
    tests = [{"of": ["ppo"], "left": "best run", "operator": "="}]
    refused("operator", Claim.model_validate, {**claims[0].model_dump(), "tests": tests})


def test_statements_follow_the_results(tmp_path: Path) -> None:
    """Results like the paper's agree with it, others do not, and what is missing is neither."""
    high, low = dict.fromkeys(load_scenario("wurtz_dodecane").goals, 1.0), {"NaCl": 1.0}
    for seed in (0, 1):
        write_run(tmp_path, "wurtz_rxn", "ppo", seed, {**high, "dodecane": 0.96 + 0.02 * seed})
        write_run(tmp_path, "wurtz_rxn", "a2c", seed, low)
        write_run(tmp_path, "wurtz_ext", "ppo-xl", seed, 1.1 + 0.1 * seed)  # 0.05 and 0.1 above 0.5
        write_run(tmp_path, "wurtz_ext", "dqn", seed, -0.1, curve=[(0, 0.0, 0.1), (1000, -0.2, 0.1)])
    found = findings(read_results(tmp_path))
    matches, gain = "PPO matches the heuristic for all targets", "PPO-XL: 0.575, scripted 0.500, best run 0.600"
    least = "agents of each algorithm achieve a return of at least 0.4"
    for figure, says, holds, ours in (
        (5, f"{matches} (best run)", True, "PPO: 7 of 7 goals, least 0.980 (dodecane)"),
        (5, f"{matches} (mean of runs)", True, "PPO: 7 of 7 goals, least 0.970 (dodecane)"),
        (5, "A2C comes close to the heuristic only for NaCl", True, None),
        (5, "heuristic, mean return", False, None),  # 0.5 is not 0.62
        (6, least, None, None),  # PPO has been trained, the others not
        (10, "the best PPO-XL policies exceed the heuristic, on average", True, gain),
        (10, "DQN ends with a negative return", True, None),
        (10, "PPO outperforms the heuristic", None, None),
        (13, "without salt, all but DQN end the experiment themselves", None, None),
    ):
        assert found[figure, says].holds is holds, says
        assert ours in (None, found[figure, says].ours), says
    # One that does not agree is enough.
    write_run(tmp_path, "wurtz_rxn", "sac", 0, curve=[(0, 0.0, 0.1), (1000, 0.3, 0.1)])
    assert findings(read_results(tmp_path))[6, least].holds is False


@pytest.mark.parametrize(
    ("means", "steps", "step", "holds"),
    [
        ((0.1, 0.61, 0.63, 0.62), 1_000_000, 200, True),
        ((0.1, 0.2, 0.63, 0.62), 1_000_000, 300, False),  # "before" 300k
        ((0.62, 0.63, 0.3, 0.62), 1_000_000, 400, False),  # left again; where it ends it is by definition
        ((0.1, 0.61, 0.63, 0.62), 310_000, 200, None),  # what comes after its end is not known
        ((0.1, 0.2, 0.3, 0.62), 410_000, 400, False),  # but that it comes this late is
    ],
)
def test_convergence_is_that_of_evaluations(
    tmp_path: Path, means: tuple[float, ...], steps: int, step: int, holds: bool | None
) -> None:
    for seed, label in itertools.product((0, 1), EXPERIMENTS["wurtz_rxn"].algorithms):
        # Two runs that differ, by less than what counts.
        evaluations = {100_000 * (i + 1): mean + 0.001 * seed for i, mean in enumerate(means)}
        write_run(tmp_path, "wurtz_rxn", label, seed, steps=steps, evaluations=evaluations)
    (found,) = (f for (_, says), f in findings(read_results(tmp_path)).items() if "converges before" in says)
    words = "at the end" if step == 400 else f"{step}k steps"
    assert found.ours.startswith(f"PPO: {words}; A2C: {words}")
    assert found.holds is holds


def test_statements_about_actions_come_from_traces(full: Path) -> None:
    found, both = findings(read_results(full)), "without NaCl 1.000, with NaCl 1.000"
    optimal = "PPO and PPO-XL achieve the optimal return with and without salt, by one agent"
    staggered = "for I the best of each add D and two of A, B, C, and the third several steps later"
    ends = "PPO-XL: ends it; PPO: ends it; A2C: ends it; DQN: runs to the limit"
    for figure, says, holds, ours in (
        (9, "for E the best A2C, PPO and SAC add A, B and C, and not D", True, "A2C: A 1.00, B 1.00, C 1.00, D 0.00;"),
        (9, "for E the best TD3 adds D as well", True, ""),
        (9, staggered, False, "PPO: 4 steps; A2C: 0 steps;"),
        (11, "PPO and PPO-XL end the experiment themselves, A2C and DQN do not", False, ends),
        (13, "without salt, all but DQN end the experiment themselves", True, ""),
        (13, optimal, True, f"PPO-XL: {both}; PPO: {both}"),
        (13, "with salt A2C only slightly modifies its actions, and DQN not at all", True, "A2C: 1.00; DQN: 1.00"),
    ):
        finding = found[figure, says]
        assert finding.holds is holds, says
        assert finding.ours == ours or (finding.ours.startswith(ours) and ours[-1:] in ("", ";")), says


def test_what_has_changed_since_is_left_out(tmp_path: Path) -> None:
    """Runs of another bench, and traces of another policy than the one that is best now."""
    write_run(tmp_path, "wurtz_dit", "ppo", 0, 1.0)
    write_run(tmp_path, "wurtz_dit", "ppo", 1, 1.5, fingerprint="another")
    write_traces(tmp_path)
    results = read_results(tmp_path)
    assert [run.result.seed for run in results.cells["wurtz_dit"]["ppo"].runs] == [0]
    assert results.left_out[0] == "wurtz_dit/ppo/seed-1: the bench has changed since it was trained"
    assert results.trace("wurtz_dit", "ppo") is not None
    write_run(tmp_path, "wurtz_dit", "ppo", 2, 1.5)
    results = read_results(tmp_path)
    assert results.trace("wurtz_dit", "ppo") is None
    assert results.trace("wurtz_dit", "scripted") is not None
    assert f"{TRACE_FILE}: Wurtz DiT, PPO: not of the best policy" in results.left_out[1]
    write_traces(tmp_path, fingerprint="another")
    results = read_results(tmp_path)
    assert results.traces == {}
    assert f"{TRACE_FILE}: Wurtz DiT: the bench has changed since" in results.left_out[2]
    (tmp_path / TRACE_FILE).write_text("experiment,policy\n")
    refused(r"traces\.csv: has the columns", read_results, tmp_path)


def test_what_is_missing_is_said_and_breaks_nothing(tmp_path: Path) -> None:
    """An empty folder, and one with a single run; pictures of earlier results go."""
    source, target = tmp_path / "results", tmp_path / "figures"
    source.mkdir()
    target.mkdir()
    (target / "figure_12_wurtz_dit_curves.png").write_text("old")
    lacking = write_figures(read_results(source), target)
    assert "traces (python -m studies.paper --collect" in lacking["figure_09_fictitious_rxn_actions"][0]
    assert "Wurtz RxN: no runs of PPO, A2C, SAC, TD3." in write_page(read_results(source), target, lacking).read_text()
    assert {path.name for path in target.iterdir()} == {"summary.md"}
    write_run(source, "wurtz_rxn", "sac", 0)
    lacking = write_figures(read_results(source), target)
    assert lacking["figure_05_wurtz_rxn_goals"] == ["finished runs of PPO, A2C, TD3"]
    drawn = {"figure_05_wurtz_rxn_goals.png", "figure_06_wurtz_rxn_curves.png"}
    assert {path.name for path in target.glob("*.png")} == drawn


def test_traces_are_collected(tmp_path: Path) -> None:
    """Scripted policy and random actions are played on every bench; figures of actions then need the file alone."""
    only = {key: EXPERIMENTS[key] for key in ("fictitious_rxn", "wurtz_dit")}
    told: list[str] = []
    traces.collect_traces(Results({key: {} for key in only}), tmp_path, episodes=8, watch=told.append)
    assert len(told) == 4
    found = read_results(tmp_path).traces
    rxn, dit = found["fictitious_rxn"], found["wurtz_dit"]
    assert np.shape(rxn["scripted"]["E"][""].actions) == (20, 6)
    random = np.array([goal[""].actions for goal in rxn["random"].values()])
    assert abs(random.mean() - 0.5) < 0.03  # uniform in [0, 1]
    cases = dit["scripted"]["dodecane"]
    assert set(cases) == {"with NaCl", "without NaCl"}
    for trace in cases.values():
        assert EXPERIMENTS["wurtz_dit"].action_names[trace.actions[-1]] == "end the experiment"
        assert trace.best_return >= trace.mean_return - 1e-9


def test_a_real_run_from_training_to_the_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its best checkpoint is played; what the tables have of other runs stays. Runs of laboratories go elsewhere."""
    monkeypatch.setattr(published, "TABLES", tmp_path / "tables")
    monkeypatch.setattr(published, "LABORATORY", tmp_path / "laboratory")
    monkeypatch.setattr(published, "collect_benches", lambda *_, **__: None)
    write_run(tmp_path / "earlier", "wurtz_dit", "dqn", 0)
    write_runs(tmp_path / "tables", read_runs(tmp_path / "earlier"))
    write_traces(tmp_path / "tables")
    before = read_results(tmp_path / "tables").traces["wurtz_dit"]["dqn"]
    runs = tmp_path / "runs"
    run_files.trained(runs / "WurtzDistillation" / "ppo" / "seed-0", scenario="chemlab/WurtzDistillation-v0")
    run_files.write_run(runs / "lab" / "seed-0", "wurtz_dodecane", "rxn_0", {"dodecane": 0.5})
    told: list[str] = []
    published.collect_all(runs, told.append)
    always = [f"{spec.title}: {p}" for spec in EXPERIMENTS.values() for p in ("scripted", "random")]
    assert told == [*always, "Wurtz DiT: ppo"]
    results = read_results(tmp_path / "tables")
    assert results.left_out == []
    assert list(results.cells["wurtz_dit"]) == ["ppo", "dqn"]
    assert results.traces["wurtz_dit"].keys() == {"scripted", "random", "ppo", "dqn"}
    assert results.traces["wurtz_dit"]["dqn"] == before
    assert results.scripted_mean("wurtz_rxn") == pytest.approx(0.626, abs=6e-4)
    assert [run.name for run in read_runs(tmp_path / "laboratory")] == ["lab/seed-0"]


def without_intervals(text: str) -> str:
    """A page's text; ends of intervals over a few runs hang on how the machine rounds."""
    return re.sub(r"\[[-+]?\d+\.\d+, [-+]?\d+\.\d+\]", "[]", text)


@pytest.mark.slow
def test_every_published_page_is_made_from_the_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the repository shows is what the command makes, with the same numbers."""
    monkeypatch.setattr(published, "write_figures", lambda results, out: {spec.stem: [] for spec in FIGURES})
    pages = {}
    for page, marks in published.PAGES.items():
        pages[tmp_path / page.name] = marks
        text = page.read_text()
        for mark in marks:
            begin, end = f"<!-- {mark}: begin -->", f"<!-- {mark}: end -->"
            text = text.partition(begin)[0] + begin + end + text.partition(end)[2]
        (tmp_path / page.name).write_text(text)
    out = tmp_path / "results"
    shutil.copytree(ROOT / "docs" / "results", out, ignore=shutil.ignore_patterns("*.md"))
    assert not [line for line in published.make(out, pages) if not line.startswith("wrote ")]
    pages |= dict.fromkeys(out.glob("*.md"))
    assert {page.name for page in pages} == {"results.md", "summary.md", "laboratory.md"}
    for page in pages:
        stands = next(path for path in (ROOT, ROOT / "docs", ROOT / "docs" / "results") if (path / page.name).exists())
        assert without_intervals(page.read_text()) == without_intervals((stands / page.name).read_text())


def test_what_cannot_be_published_leaves_everything_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_run(tmp_path / "runs", "wurtz_dit", "ppo", 0, fingerprint="another")
    write_runs(tmp_path / "tables", read_runs(tmp_path / "runs"))
    monkeypatch.setattr(published, "TABLES", tmp_path / "tables")
    with pytest.raises(ValueError, match=r"1 runs and traces .*seed-0: the bench has changed since it was trained"):
        published.make(tmp_path / "out", {tmp_path / "page.md": ("paper",)})
    assert not (tmp_path / "out").exists()


def test_the_published_tables_are_small_and_of_finished_runs() -> None:
    runs = {folder: read_runs(folder) for folder in (module.TABLES, published.LABORATORY)}
    assert sum(path.stat().st_size for folder in runs for path in folder.iterdir()) < 1_000_000
    paper, others = runs.values()
    assert {experiment_of(run) for run in paper} == set(EXPERIMENTS)
    assert {experiment_of(run) for run in others} == {None}
    assert all(run.finished.steps > 0 and len(run.curve) > 1 and run.evaluations for run in (*paper, *others))
    assert len({run.name for run in (*paper, *others)}) == len(paper) + len(others)


def test_the_papers_sweep_is_complete() -> None:
    runs = plan(module.TABLES.with_name("experiments.toml"), Path("results"))
    cells = Counter(one.name.rpartition("/")[0] for one in runs)
    reactions = [f"{b}Reaction/{a}" for b in ("Wurtz", "Fictitious") for a in ("ppo", "a2c", "sac", "td3")]
    others = [f"Wurtz{b}/{a}" for b in ("Extraction", "Distillation") for a in ("ppo", "ppo-xl", "a2c", "dqn")]
    assert {cell: cells[cell] for cell in [*reactions, *others]} == dict.fromkeys([*reactions, *others], 5)
    wide = [one.arguments for one in runs if one.arguments.preset == "ppo-xl"]
    # The paper has it for ExT and DiT alone.
    assert {one.steps for one in wide if "Reaction" not in one.env_id} == {2_000_000}
    assert {one.name for one in runs} == {run.name for run in read_runs(module.TABLES)}
