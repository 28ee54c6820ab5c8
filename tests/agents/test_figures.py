"""Figures and tables from results files: what is read, what is drawn, what is said of it."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from chemlab.agents.evaluation.results import EXPERIMENTS, Cell, Results, read_results, trace_source
from chemlab.agents.evaluation.statements import compare_with_paper
from chemlab.agents.evaluation.summary import describe_cells, paper_table, write_summary
from chemlab.agents.runs import CurvePoint, Evaluation, Run, RunConfig, RunResult
from chemlab.agents.training.tasks import BenchTask
from chemlab.cli import app
from chemlab.scenario import load_scenario

pytest.importorskip("matplotlib")

from chemlab.agents.evaluation.figures import FIGURES, algorithm_style, learning_curve, write_figures
from chemlab.render.figure import SETTINGS

runner = CliRunner()
HEURISTIC = 0.5


@cache
def _now(experiment: str) -> str:
    """The fingerprint of the experiment's bench."""
    spec = EXPERIMENTS[experiment]
    return BenchTask(spec.scenario, spec.bench).fingerprint


def write_run(
    folder: Path,
    experiment: str,
    label: str,
    seed: int,
    relative: float | dict[str, float] = 1.0,
    curve: Sequence[tuple[int, float | None, float | None]] = ((100, 0.1, 0.2), (1000, 0.4, 0.2)),
    finished: bool = True,
    **settings: Any,
) -> Path:
    """A run's files, as training writes them; ``relative`` to a scripted policy that gets 0.5 for every goal."""
    spec = EXPERIMENTS[experiment]
    goals = list(load_scenario(spec.scenario).goals)
    ratios = {goal: relative if isinstance(relative, float) else relative.get(goal, 0.0) for goal in goals}
    by_goal = {goal: HEURISTIC * ratio for goal, ratio in ratios.items()}
    mean = float(np.mean(list(by_goal.values())))
    run = Run(folder / experiment / label / f"seed-{seed}")
    run.path.mkdir(parents=True)
    fingerprint = settings.pop("fingerprint", _now(experiment))
    arguments = {"env_id": "chemlab/Any-v0", "algo": label, "steps": 1000, "seed": seed, "starts": "paper", **settings}
    config = RunConfig(label, arguments, spec.scenario, spec.bench, goals, fingerprint)
    run.config_file.write_text(json.dumps(config.as_dict()))
    for step, value, deviation in curve:
        run.append(CurvePoint(step, value, deviation, 5, 1.0))
    if finished:
        heuristic = dict.fromkeys(goals, HEURISTIC)
        result = RunResult(
            *("chemlab/Any-v0", label, label, seed, int(arguments["steps"])),
            *(60.0, 1000.0, 900, 10, mean, by_goal, HEURISTIC, heuristic, mean - 0.1, by_goal),
        )
        run.result_file.write_text(json.dumps(vars(result)))
    return run.path


def mean_actions(label: str, goal: str) -> list[list[float]]:
    """For E all of A, B and C, and TD3 D as well; for I C comes in the fifth step, but A2C's with the others."""
    first = [0.1, 0.2, 1.0, 1.0, 1.0, float(label == "td3")]
    if goal != "I":
        return [first] * 20
    late = [[0.1, 0.2, 1.0, 1.0, 0.0, 1.0]] * 4 + [[0.1, 0.2, 0.0, 0.0, 1.0, 0.0]] * 16
    return [[0.1, 0.2, 1.0, 1.0, 1.0, 1.0]] * 20 if label == "a2c" else late


def write_traces(folder: Path) -> None:
    """Traces of every algorithm's best run: made up, in the shape that collecting gives them."""
    experiments: dict[str, Any] = {}
    results = read_results(folder)
    for key, spec in EXPERIMENTS.items():
        scenario = load_scenario(spec.scenario)
        policies: dict[str, Any] = {}
        names = ["temperature", "volume", "add A", "add B", "add C", "add D"]
        if spec.bench != "rxn":
            names = [
                "heat DV, 50 kJ",
                "pour B1 -> B2, 0.2 fraction",
                "add diethyl_ether to EV, 0.05 L",
                "settle, 2 clock",
            ]
            names += ["drain EV -> B1, 16 % of the height", "end the experiment"]
        for label in ("heuristic", "random", *spec.algorithms):
            by_goal: dict[str, Any] = {}
            for goal in scenario.goals:
                cases = ["with NaCl", "without NaCl"] if spec.bench == "dit" else [""]
                actions = [0, 1, 2, 3, 4] * 10 if label == "dqn" else [0] * 7 + [1, 5]
                entry = {"episodes": 2, "mean_return": 0.5, "best": {"return": 0.5, "actions": actions}}
                by_goal[goal] = {"mean_return": 0.5, "by_case": dict.fromkeys(cases, entry)}
                if spec.bench == "rxn":
                    by_goal[goal]["mean_actions"] = mean_actions(label, goal)
            cell = results.cell(key, label)
            source = None if cell is None else trace_source(folder, cell)
            policies[label] = {"source": source, "mean_return": 0.5, "by_goal": by_goal}
        experiments[key] = {
            "fingerprint": _now(key),
            "action_names": names,
            "goals": list(scenario.goals),
            "policies": policies,
        }
    (folder / "traces.json").write_text(json.dumps({"kind": "traces", "format": 2, "experiments": experiments}))


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two runs of everything, and traces."""
    folder = tmp_path_factory.mktemp("results")
    for key, spec in EXPERIMENTS.items():
        for label, seed in itertools.product(spec.algorithms, (0, 1)):
            write_run(folder, key, label, seed, 1.0 + 0.1 * seed)
    write_traces(folder)
    return folder


# -- reading ----------------------------------------------------------------------------------------------------------


def test_runs_find_their_cells(tmp_path: Path) -> None:
    """Runs that differ in more than the seed are not mixed; the paper's cells have its starting states."""
    for seed in (0, 1, 2):
        write_run(tmp_path / "a", "wurtz_rxn", "ppo", seed)
    write_run(tmp_path / "b", "wurtz_rxn", "ppo", 0, steps=5000)
    write_run(tmp_path / "b", "wurtz_rxn", "a2c", 0, starts="lab")
    write_run(tmp_path / "b", "wurtz_dit", "ppo", 0, finished=False)
    results = read_results(tmp_path)
    cell = results.cell("wurtz_rxn", "ppo")
    assert cell is not None
    assert [run.result.seed for run in cell.runs] == [0, 1, 2]
    assert cell.steps == 1000
    assert results.missing("wurtz_rxn") == ["a2c", "sac", "td3"]
    assert [(line.partition(":")[0], line.partition(": ")[2]) for line in sorted(results.left_out)] == [
        ("b/wurtz_dit/ppo/seed-0", "not finished"),
        ("b/wurtz_rxn/a2c/seed-0", "not one of the paper's experiments"),
        ("b/wurtz_rxn/ppo/seed-0", "trained in another way than most ppo runs there"),
    ]


def test_of_equally_many_runs_the_longer_ones_count(tmp_path: Path) -> None:
    for seed in (0, 1):
        write_run(tmp_path / "short", "wurtz_ext", "ppo", seed)
        write_run(tmp_path / "long", "wurtz_ext", "ppo", seed, steps=9000)
    cell = read_results(tmp_path).cell("wurtz_ext", "ppo")
    assert cell is not None
    assert cell.steps == 9000


def test_a_folder_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such folder"):
        read_results(tmp_path / "nothing")
    done = runner.invoke(app, ["figures", str(tmp_path / "nothing")])
    assert done.exit_code == 2
    assert "no such folder" in done.output


def cell_of(folder: Path, experiment: str, label: str) -> Cell:
    """A cell that is there."""
    cell = read_results(folder).cell(experiment, label)
    assert cell is not None
    return cell


def test_learning_curves_against_closed_forms(tmp_path: Path) -> None:
    """Two straight curves of other lengths: the mean on what they share; deviations of runs and of single returns."""
    write_run(tmp_path, "wurtz_rxn", "ppo", 0, curve=[(0, 0.0, 0.5), (50, None, None), (1000, 1.0, 0.5)])
    write_run(tmp_path, "wurtz_rxn", "ppo", 1, curve=[(100, 2.1, 0.5), (800, 2.8, 0.5)])
    found = learning_curve(cell_of(tmp_path, "wurtz_rxn", "ppo"))
    assert found is not None
    steps, mean, between, single = found
    assert (steps[0], steps[-1]) == (100.0, 800.0)
    np.testing.assert_allclose(mean, steps / 1000.0 + 1.0)
    np.testing.assert_allclose(between, math.sqrt(2.0))  # of the two values x and x + 2
    np.testing.assert_allclose(single, math.sqrt(0.5**2 + 1.0**2))
    write_run(tmp_path, "wurtz_rxn", "sac", 0)
    alone = learning_curve(cell_of(tmp_path, "wurtz_rxn", "sac"))
    assert alone is not None
    assert np.isnan(alone[2]).all()
    write_run(tmp_path, "wurtz_rxn", "td3", 0, curve=[])
    assert learning_curve(cell_of(tmp_path, "wurtz_rxn", "td3")) is None


# -- drawing ----------------------------------------------------------------------------------------------------------


def drawn(folder: Path, stem: str) -> Any:
    """A figure of a folder's results."""
    import matplotlib

    spec = next(spec for spec in FIGURES if spec.stem == stem)
    with matplotlib.rc_context(SETTINGS):
        return spec.draw(read_results(folder))


def lines_of(axes: Any) -> dict[str, Any]:
    """{label: y of the line}."""
    return {line.get_label(): np.asarray(line.get_ydata()) for line in axes.get_lines()}


def test_variants_have_looks_of_their_own() -> None:
    labels = ["ppo", "a2c", "sac", "td3", "ppo-entropy", "ppo-xl", "sac-cool", "td3-wide"]
    looks = [algorithm_style(label, labels) for label in labels]
    assert len({look["color"] for look in looks}) == len(labels)
    assert len({str(look["linestyle"]) for look in looks[4:] if look is not looks[5]}) == 3


def test_radar_shows_relative_returns(tmp_path: Path) -> None:
    """(a) is the best run, (b) the mean over runs; below 0 is drawn as 0; the ring of the heuristic is 1."""
    goals = load_scenario("fictitious").goals
    write_run(tmp_path, "fictitious_rxn", "ppo", 0, dict(zip(goals, (1.0, 0.8, 0.6, 0.4, -0.5), strict=True)))
    write_run(tmp_path, "fictitious_rxn", "ppo", 1, dict(zip(goals, (1.2, 1.0, 0.8, 0.6, 0.1), strict=True)))
    figure = drawn(tmp_path, "figure_07_fictitious_rxn_goals").figure
    best, mean = (lines_of(axes) for axes in figure.axes)
    np.testing.assert_allclose(best["PPO (2 runs)"], [1.2, 1.0, 0.8, 0.6, 0.1, 1.2])
    np.testing.assert_allclose(mean["PPO (2 runs)"], [1.1, 0.9, 0.7, 0.5, 0.0, 1.1], atol=1e-12)
    assert (best["heuristic"] == 1.0).all()


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
        assert (lines_of(axes)["heuristic"] == HEURISTIC).all()
        np.testing.assert_allclose(lines_of(axes)["PPO (2 runs)"], 2.0)
        assert len(axes.collections) == 1  # the band of PPO; one run of A2C has none
        extent = axes.collections[0].get_paths()[0].get_extents()
        assert (extent.y0, extent.y1) == pytest.approx((2.0 - half, 2.0 + half))
    words = " ".join(text.get_text() for text in found.figure.texts)
    assert "One run has no spread: A2C" in words
    assert "DQN" in found.missing[0]


def test_actions_by_goal(full: Path) -> None:
    """A row for each policy, a column for each action, a curve for each goal."""
    figure = drawn(full, "figure_09_fictitious_rxn_actions").figure
    assert len(figure.axes) == 5 * 6
    assert [axes.get_ylabel() for axes in figure.axes[::6]] == ["PPO", "A2C", "SAC", "TD3", "heuristic"]
    titles = ["temperature", "volume", "add A", "add B", "add C", "add D"]
    assert [axes.get_title() for axes in figure.axes[:6]] == titles
    for column, axes in enumerate(figure.axes[:6]):
        assert list(lines_of(axes)) == ["E", "F", "G", "H", "I"]
        for goal, values in lines_of(axes).items():
            np.testing.assert_allclose(values, np.array(mean_actions("ppo", goal))[:, column])


def test_sequences_fold_repeated_actions(full: Path) -> None:
    """Equal actions are one box with their number; a long sequence says how much is left out; salt has its part."""
    figure = drawn(full, "figure_13_wurtz_dit_sequences").figure
    texts = [text.get_text() for text in figure.axes[0].texts]
    start = texts.index("PPO\nreturn 0.500")
    assert texts[start : start + 7] == [
        "PPO\nreturn 0.500",
        "heat DV\n50 kJ",
        "x 7",
        "pour B1→B2\n20 %",
        "x 1",
        "end",
        "x 1",
    ]
    assert texts.count("and 24\nmore steps") == 2  # 50 steps, of which 26 boxes are shown, in two cases
    assert [text for text in texts if "at the start" in text] == ["without NaCl at the start", "with NaCl at the start"]
    ext = {text.get_text() for text in drawn(full, "figure_11_wurtz_ext_sequences").figure.axes[0].texts}
    assert {"add diethyl\nether\n0.05 L", "settle\ntime 2", "drain EV→B1\n16 %"} <= ext


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
    for text, box in boxes:
        assert min(box.x0, box.y0) >= 0.0, text
        assert box.x1 <= figure.bbox.x1, text
        assert box.y1 <= figure.bbox.y1, text
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


# -- tables -----------------------------------------------------------------------------------------------------------


def test_statements_follow_the_results(tmp_path: Path) -> None:
    """Results like the paper's agree with it, others do not, and what is missing is neither."""
    high, low = dict.fromkeys(load_scenario("wurtz_dodecane").goals, 1.0), {"NaCl": 1.0}
    for seed in (0, 1):
        write_run(tmp_path, "wurtz_rxn", "ppo", seed, {**high, "dodecane": 0.96 + 0.02 * seed})
        write_run(tmp_path, "wurtz_rxn", "a2c", seed, low)
        write_run(tmp_path, "wurtz_ext", "ppo-xl", seed, 1.1 + 0.1 * seed)  # 0.05 and 0.1 above 0.5
        write_run(tmp_path, "wurtz_ext", "dqn", seed, -0.1, curve=[(0, 0.0, 0.1), (1000, -0.2, 0.1)])
    found = {(s.figure, s.says): s for s in compare_with_paper(read_results(tmp_path))}
    best = found[5, "PPO matches the heuristic for all targets (best run)"]
    assert (best.holds, best.ours) == (True, "PPO: 7 of 7 goals at 0.97 or more, least 0.980 (dodecane)")
    mean = found[5, "PPO matches the heuristic for all targets (mean of runs)"]
    assert (mean.holds, mean.ours) == (True, "PPO: 7 of 7 goals at 0.97 or more, least 0.970 (dodecane)")
    assert found[5, "A2C comes close to the heuristic only for NaCl"].holds is True
    assert found[5, "heuristic, mean return"].holds is False  # 0.5 is not 0.62
    gain = found[10, "the best PPO-XL policies exceed the heuristic, on average"]
    assert (gain.holds, gain.ours) == (True, "PPO-XL: +0.075 (best run +0.100)")
    assert found[10, "DQN ends with a negative return"].holds is True
    assert found[10, "PPO outperforms the heuristic"].holds is None
    # PPO has been trained, the others not: one that does not agree is enough.
    assert found[6, "agents of each algorithm achieve a return of at least 0.4"].holds is None
    write_run(tmp_path, "wurtz_rxn", "sac", 0, curve=[(0, 0.0, 0.1), (1000, 0.3, 0.1)])
    again = {(s.figure, s.says): s for s in compare_with_paper(read_results(tmp_path))}
    assert again[6, "agents of each algorithm achieve a return of at least 0.4"].holds is False
    assert found[13, "without salt, all but DQN end the experiment themselves"].holds is None


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
        path = write_run(tmp_path, "wurtz_rxn", label, seed, steps=steps)
        for i, mean in enumerate(means):
            # Two runs that differ, by less than what counts.
            Run(path).append(Evaluation(100_000 * (i + 1), mean + 0.001 * seed, {}, None, None))
    (found,) = (s for s in compare_with_paper(read_results(tmp_path)) if "converges before" in s.says)
    assert found.ours.startswith(f"PPO: by {step}k of {steps // 1000}k steps; A2C: by {step}k")
    assert found.holds is holds


def test_variants_are_named_beside_the_papers_own(tmp_path: Path) -> None:
    """The paper's algorithm decides; variants that agree where it does not are named. They are drawn beside it."""
    write_run(tmp_path, "wurtz_ext", "ppo", 0, 0.9)
    write_run(tmp_path, "wurtz_ext", "ppo-entropy", 0, 1.2)
    results = read_results(tmp_path)
    found = {s.says: s for s in compare_with_paper(results)}["PPO outperforms the heuristic"]
    assert (found.holds, found.variants, found.ours) == (
        False,
        ("PPO-entropy",),
        "PPO: -0.050 (best run -0.050); PPO-entropy: +0.100 (best run +0.100)",
    )
    page, _ = write_summary(results, tmp_path, dict.fromkeys((spec.stem for spec in FIGURES), ()))
    assert "| **no** (PPO-entropy: yes) |" in page.read_text()
    assert list(results.cells["wurtz_ext"]) == ["ppo", "ppo-entropy"]
    lines = drawn(tmp_path, "figure_10_wurtz_ext_curves").figure.axes[0].get_lines()
    assert [line.get_label() for line in lines] == ["PPO (1 run)", "PPO-entropy (1 run)", "heuristic"]
    assert len({line.get_color() for line in lines}) == 3


def test_statements_about_actions_come_from_traces(full: Path) -> None:
    found = {(s.figure, s.says): s for s in compare_with_paper(read_results(full))}
    ends = found[11, "PPO and PPO-XL end the experiment themselves, A2C and DQN do not"]
    assert ends.holds is False
    assert ends.ours == "PPO-XL: ends it; PPO: ends it; A2C: ends it; DQN: runs to the limit"
    assert found[13, "without salt, all but DQN end the experiment themselves"].holds is True
    salt = found[13, "PPO and PPO-XL achieve the optimal return with and without salt, by one agent"]
    assert (salt.holds, salt.ours) == (
        True,
        "PPO-XL: 1.000 without, 1.000 with salt; PPO: 1.000 without, 1.000 with salt",
    )
    same = found[13, "with salt A2C only slightly modifies its actions, and DQN not at all"]
    assert (same.holds, same.ours) == (True, "A2C: 1.00 in common; DQN: 1.00 in common")
    e = found[9, "for E the best A2C, PPO and SAC add A, B and C, and not D"]
    assert (e.holds, e.ours.partition(";")[0]) == (True, "A2C: A 1.00, B 1.00, C 1.00, D 0.00")
    assert found[9, "for E the best TD3 adds D as well"].holds is True
    staggered = found[9, "for I the best of each add D and two of A, B, C, and the third several steps later"]
    assert staggered.ours.split("; ")[:2] == [
        "PPO: A step 1, B step 1, C step 5, D step 1",
        "A2C: A step 1, B step 1, C step 1, D step 1",
    ]
    assert staggered.holds is False


def test_one_sequence_that_differs_with_salt(full: Path, tmp_path: Path) -> None:
    """DQN's have to be equal; of equal returns alone nothing follows."""
    content = json.loads((full / "traces.json").read_text())
    entry = content["experiments"]["wurtz_dit"]["policies"]["dqn"]["by_goal"]["dodecane"]["by_case"]
    entry["with NaCl"] = {**entry["with NaCl"], "best": {"return": 0.5, "actions": [0, 1, 2, 3, 4] * 9}}
    results = read_results(full)
    results.traces = content
    (same,) = (s for s in compare_with_paper(results) if "only slightly modifies" in s.says)
    assert (same.holds, same.ours) == (False, "A2C: 1.00 in common; DQN: 0.95 in common")


def verdict(folder: Path, key: str, says: str) -> bool | None:
    """Whether the statement on an experiment that has these words holds."""
    statements = compare_with_paper(read_results(folder))
    (found,) = (s for s in statements if says in s.says and s.experiment == EXPERIMENTS[key].title)
    return found.holds


WURTZ, FICTITIOUS = load_scenario("wurtz_dodecane").goals, load_scenario("fictitious").goals
ENDS = [(0, 0.0, 0.1)]  # of a curve: its last point is where training ends
LOW = dict.fromkeys(WURTZ, 0.5) | {"NaCl": 1.0}


@pytest.mark.parametrize(
    ("says", "key", "agreeing", "other"),
    [
        # By algorithm: relative returns of two runs (or of each goal), and where training ends.
        ("come close on a few", "wurtz_rxn", {"sac": {**LOW, "dodecane": 0.95}, "td3": 0.9}, {"sac": LOW, "td3": 0.9}),
        ("consistently produces NaCl", "wurtz_rxn", dict.fromkeys(("ppo", "a2c", "sac", "td3"), LOW), {"td3": 0.8}),
        (
            "for all 7 targets",
            "wurtz_rxn",
            {"ppo": 1.0, "a2c": 0.9, "sac": 0.9, "td3": LOW | {"NaCl": 0.9}},
            {"a2c": LOW},
        ),
        ("SAC and TD3 agents outperform", "wurtz_rxn", {"sac": 0.8, "td3": 0.8, "a2c": 0.7}, {"a2c": 0.8}),
        (
            "consistently matches",
            "fictitious_rxn",
            {"ppo": 0.98},
            {"ppo": {**dict.fromkeys(FICTITIOUS, 1.0), "F": 0.9}},
        ),
        (
            "all products but I",
            "fictitious_rxn",
            {n: dict.fromkeys("EFGH", 0.95) for n in ("a2c", "sac")},
            {"sac": 0.95},
        ),
        ("all products but E", "fictitious_rxn", {"td3": dict.fromkeys("FGHI", 0.95)}, {"td3": 0.95}),
        ("for all 5 targets", "fictitious_rxn", {"ppo": 1.0, "a2c": 0.9, "sac": 0.9, "td3": 0.9}, {"td3": 1.0}),
        ("alone succeeds with both", "fictitious_rxn", {"ppo": 1.0, "a2c": 0.5, "sac": 0.5, "td3": 0.5}, {"td3": 0.9}),
        (
            "consistently outperform the other",
            "wurtz_ext",
            {"ppo-xl": 0.6, "ppo": 0.6, "a2c": 0.5, "dqn": 0.5},
            {"dqn": 0.6},
        ),
        ("as much as ending", "wurtz_ext", {"a2c": 0.02}, {"a2c": 0.1}),
        ("best PPO policy outperforms the best DQN", "wurtz_dit", {"ppo": 0.9, "dqn": 0.8}, {"dqn": 0.9}),
        ("others on average", "wurtz_dit", {"ppo-xl": 1.0, "ppo": 0.9, "a2c": 0.5, "dqn": 0.5}, {"ppo": 1.0}),
        ("others in the best case", "wurtz_dit", {"ppo-xl": 1.0, "ppo": 0.9, "a2c": 0.5, "dqn": 0.5}, {"dqn": 1.0}),
    ],
)
def test_statements_about_returns(
    tmp_path: Path, says: str, key: str, agreeing: dict[str, Any], other: dict[str, Any]
) -> None:
    """Each holds for results like the paper's, and not once one algorithm's are others."""
    for folder, relatives in (("yes", agreeing), ("no", {**agreeing, **other})):
        for label, relative in relatives.items():
            for seed in (0, 1):
                write_run(tmp_path / folder, key, label, seed, relative)
        assert verdict(tmp_path / folder, key, says) is (folder == "yes")


@pytest.mark.parametrize(
    ("says", "key", "agreeing", "other"),
    [
        (
            "a return of at least 0.4",
            "wurtz_rxn",
            dict.fromkeys(("ppo", "a2c", "sac", "td3"), (0.4, 0.5)),
            {"sac": (0.3, 0.4)},
        ),
        (
            "not much better than random",
            "wurtz_rxn",
            dict.fromkeys(("a2c", "sac", "td3"), (0.55, 0.6)),
            {"td3": (0.6, 0.7)},
        ),
        ("PPO is significantly better", "wurtz_rxn", {"ppo": (0.65, 0.7)}, {"ppo": (0.5, 0.55)}),
        ("not achieve a return above zero", "wurtz_ext", {"a2c": (0.0, 0.02)}, {"a2c": (0.0, 0.1)}),
        ("consistently acquire positive", "wurtz_ext", {"ppo-xl": (0.1, 0.2), "ppo": (0.1, 0.2)}, {"ppo": (0.0, 0.9)}),
        (
            "DQN, PPO and PPO-XL consistently",
            "wurtz_dit",
            dict.fromkeys(("dqn", "ppo", "ppo-xl"), (0.1, 0.2)),
            {"dqn": (0.0, 0.9)},
        ),
        ("positive returns on average", "wurtz_dit", {"a2c": (-0.1, 0.2)}, {"a2c": (-0.2, 0.1)}),
        ("acquire similar returns", "wurtz_dit", {"ppo": (0.7, 0.7), "dqn": (0.65, 0.65)}, {"dqn": (0.5, 0.5)}),
        ("vary more than", "wurtz_dit", {"ppo": (0.5, 0.7), "dqn": (0.6, 0.61)}, {"dqn": (0.4, 0.7)}),
    ],
)
def test_statements_about_where_training_ends(
    tmp_path: Path, says: str, key: str, agreeing: dict[str, Any], other: dict[str, Any]
) -> None:
    """The same of the ends of two learning curves; random actions come to 0.5 in the made-up traces."""
    for folder, ends in (("yes", agreeing), ("no", {**agreeing, **other})):
        for label, values in ends.items():
            for seed, end in enumerate(values):
                write_run(tmp_path / folder, key, label, seed, curve=[*ENDS, (1000, end, 0.1)])
        write_traces(tmp_path / folder)
        assert verdict(tmp_path / folder, key, says) is (folder == "yes")


def test_statements_about_pace_and_distance(tmp_path: Path) -> None:
    """Figure 8: steps are compared with PPO's, distances to the optimum at equal numbers of steps."""
    paces = {"ppo": (0.4, 0.5, 0.5, 0.5), "a2c": (0.1, 0.1, 0.1, 0.2), "sac": (0.1, 0.1, 0.1, 0.2)}
    for label, means in {**paces, "td3": (0.1, 0.1, 0.1, 0.2)}.items():
        path = write_run(tmp_path, "fictitious_rxn", label, 0, 0.8)
        write_run(tmp_path, "wurtz_rxn", label, 0, 0.7)
        for i, mean in enumerate(means):
            Run(path).append(Evaluation(100 * (i + 1), mean, {}, None, None))
    assert verdict(tmp_path, "fictitious_rxn", "PPO converges quickly") is True
    assert verdict(tmp_path, "fictitious_rxn", "nearer to the optimum than on Wurtz") is True
    slow = write_run(tmp_path, "fictitious_rxn", "td3", 1, 0.6)
    for i in range(4):
        Run(slow).append(Evaluation(100 * (i + 1), 0.3 - 0.1 * (i < 1), {}, None, None))
    assert verdict(tmp_path, "fictitious_rxn", "nearer to the optimum than on Wurtz") is False  # TD3: 0.7 and 0.7
    (tmp_path / "fictitious_rxn" / "td3" / "seed-0" / "evaluations.jsonl").unlink()
    for i in range(4):
        Run(tmp_path / "fictitious_rxn" / "td3" / "seed-0").append(Evaluation(100 * (i + 1), 0.3, {}, None, None))
    assert verdict(tmp_path, "fictitious_rxn", "PPO converges quickly") is False  # TD3 is as quick
    for seed in (2, 3, 4):
        write_run(tmp_path, "wurtz_rxn", "a2c", seed, 0.7, steps=300)
    assert verdict(tmp_path, "fictitious_rxn", "nearer to the optimum than on Wurtz") is False  # TD3's still
    for run in (tmp_path / "fictitious_rxn" / "td3").iterdir():
        (run / "result.json").unlink()
    assert (
        verdict(tmp_path, "fictitious_rxn", "nearer to the optimum than on Wurtz") is None
    )  # A2C's steps differ, TD3 is missing


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
    assert results.trace("wurtz_dit", "heuristic") is not None
    assert any(line.startswith("traces.json: Wurtz DiT, ppo: not of the best policy") for line in results.left_out)
    file = tmp_path / "traces.json"
    content = json.loads(file.read_text())
    content["experiments"]["wurtz_dit"]["fingerprint"] = "another"
    file.write_text(json.dumps(content))
    results = read_results(tmp_path)
    assert results.trace("wurtz_dit", "heuristic") is None
    assert results.trace("wurtz_ext", "heuristic") is not None
    assert "traces.json: Wurtz DiT: the bench has changed since" in results.left_out[1]
    file.write_text(json.dumps({**content, "format": 1}))
    assert read_results(tmp_path).traces is None
    file.write_text("{}")
    with pytest.raises(ValueError, match="not what chemlab figures --collect writes"):
        read_results(tmp_path)


def test_a_single_run_has_no_interval(tmp_path: Path) -> None:
    write_run(tmp_path, "wurtz_dit", "ppo", 0, 1.0)
    (row,) = (row for row in describe_cells(read_results(tmp_path)) if row["runs"])
    assert row["mean"] == {"value": 0.5, "low": None, "high": None}
    assert "| PPO |  |  |  | 0.500 |" in paper_table(read_results(tmp_path))


def test_cells_have_intervals_over_runs(tmp_path: Path) -> None:
    for seed, relative in enumerate((0.8, 1.0, 1.2, 1.4)):
        write_run(tmp_path, "wurtz_dit", "ppo", seed, relative)
    rows = {(row["experiment"], row["label"]): row for row in describe_cells(read_results(tmp_path))}
    row = rows["wurtz_dit", "ppo"]
    assert row["mean"]["value"] == pytest.approx(0.55)  # of 0.4, 0.5, 0.6, 0.7
    assert row["interquartile_mean"]["value"] == pytest.approx(0.55)
    assert row["mean"]["low"] < 0.55 < row["mean"]["high"]
    assert row["best"] == pytest.approx(0.7)
    assert row["improvement"]["value"] == pytest.approx((0 + 0.5 + 1 + 1) / 4)
    assert rows["wurtz_dit", "dqn"]["runs"] == 0
    assert len(rows) == 16


# -- the command ------------------------------------------------------------------------------------------------------


def test_everything_comes_from_files(full: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All figures, both tables; nothing is played, and the results are left as they were."""
    import chemlab.agents.evaluation.traces as traces

    monkeypatch.setattr(traces, "play_bench", None)
    before = sorted(full.rglob("*"))
    done = runner.invoke(app, ["figures", str(full), "-o", str(tmp_path), "--format", "png", "--format", "svg"])
    assert done.exit_code == 0, done.output
    stems = [spec.stem for spec in FIGURES]
    files = {*(f"{stem}.{ending}" for stem in stems for ending in ("png", "svg")), "summary.md", "summary.json"}
    assert {path.name for path in tmp_path.iterdir()} == files
    assert sorted(full.rglob("*")) == before
    page = (tmp_path / "summary.md").read_text()
    assert all(f"![{stem}]({stem}.png)" in page for stem in stems)
    data = json.loads((tmp_path / "summary.json").read_text())
    assert data["cells"][0]["mean"]["value"] == pytest.approx(HEURISTIC * 1.05)
    assert [len(lacks["lacks"]) for lacks in data["figures"].values()] == [0] * 9
    only = tmp_path / "svg"
    done = runner.invoke(app, ["figures", str(full), "-o", str(only), "--format", "svg"])
    assert done.exit_code == 0, done.output
    assert all(f"![{stem}]({stem}.svg)" in (only / "summary.md").read_text() for stem in stems)


def test_what_is_missing_is_said_and_breaks_nothing(tmp_path: Path) -> None:
    """An empty folder, and one with a single run; pictures of earlier results go."""
    source, target = tmp_path / "results", tmp_path / "figures"
    source.mkdir()
    target.mkdir()
    (target / "figure_12_wurtz_dit_curves.png").write_text("old")
    done = runner.invoke(app, ["figures", str(source), "-o", str(target)])
    assert done.exit_code == 0, done.output
    assert {path.name for path in target.iterdir()} == {"summary.md", "summary.json"}
    assert "traces.json" in done.output
    write_run(source, "wurtz_rxn", "sac", 0)
    lacking = write_figures(read_results(source), target)
    assert lacking["figure_05_wurtz_rxn_goals"] == ["finished runs of PPO, A2C, TD3"]
    assert {path.name for path in target.glob("*.png")} == {
        "figure_05_wurtz_rxn_goals.png",
        "figure_06_wurtz_rxn_curves.png",
    }


def test_an_unknown_format_leaves_no_litter(full: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="supported"):
        write_figures(read_results(full), tmp_path, ["bmp2"])
    assert list(tmp_path.iterdir()) == []


def test_traces_are_collected_beside_the_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scripted policy and random actions are played on every bench; figures of actions then need the file alone."""
    import chemlab.agents.evaluation.traces as traces

    only = {key: EXPERIMENTS[key] for key in ("fictitious_rxn", "wurtz_dit")}
    results = Results(tmp_path, {key: {} for key in only})
    collected = traces.collect_traces(results, episodes=8)
    assert json.loads((tmp_path / "traces.json").read_text()) == json.loads(json.dumps(collected))
    rxn = collected["experiments"]["fictitious_rxn"]
    assert rxn["action_names"] == ["temperature", "volume", "add A", "add B", "add C", "add D"]
    assert np.shape(rxn["policies"]["heuristic"]["by_goal"]["E"]["mean_actions"]) == (20, 6)
    random = np.array([goal["mean_actions"] for goal in rxn["policies"]["random"]["by_goal"].values()])
    assert abs(random.mean() - 0.5) < 0.03  # uniform in [0, 1]
    dit = collected["experiments"]["wurtz_dit"]
    cases = dit["policies"]["heuristic"]["by_goal"]["dodecane"]["by_case"]
    assert set(cases) == {"with NaCl", "without NaCl"}
    for entry in cases.values():
        assert dit["action_names"][entry["best"]["actions"][-1]] == "end the experiment"
        assert entry["best"]["return"] >= entry["mean_return"] - 1e-12


def test_a_page_that_is_not_there_is_refused_before_anything_is_made(full: Path, tmp_path: Path) -> None:
    arguments = ["figures", str(full), "--out", str(tmp_path / "out"), "--update", str(tmp_path / "missing.md")]
    said = runner.invoke(app, arguments)
    assert said.exit_code == 2
    assert "no such file" in said.output.replace("\n", " ")
    assert not (tmp_path / "out").exists()
