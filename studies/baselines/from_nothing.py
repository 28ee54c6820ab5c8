"""Managers and teams that learned from nothing, beside untrained managers over scripted benches.

``python studies/baselines/from_nothing.py RESULTS`` plays the best checkpoint of each finished run below RESULTS
(``from_nothing.toml`` and ``stages.toml``; runs of other sweeps are left out), also where no measurement can be paid,
and, on the same episodes, the scripted, the random and the idle manager and the best of ``--plans`` open-loop plans. Of
scenarios with hidden parameters it also plays the test episodes of the committed audit, and 1,000 episodes of
``validation`` and of ``test`` beside the scripted agents, for the mean differences with their intervals. It adds the
scores to ``results/from_nothing.json``.
Without RESULTS nothing is played: tables and figure of docs/training.md are written from that file.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import warnings
from pathlib import Path
from typing import Any

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.evaluate.benchmark import world_scenarios
from chemlab.agents.evaluate.jobs import AUDIT_SEED, Job, JobRunner, budget_of, without_instruments
from chemlab.agents.evaluate.play import Target, evaluate
from chemlab.agents.evaluate.search import search_plan
from chemlab.agents.evaluate.statistics import interval_text
from chemlab.agents.policies import make_policies
from chemlab.agents.runs import RESULT_SEED, Run, find_runs
from chemlab.config.display import markdown_table
from chemlab.config.files import replace_between, write_json
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import MANAGER_AGENT, Scenario
from chemlab.envs.players import Policy, as_policy
from chemlab.lab.engine import Laboratories
from chemlab.lab.starts import goals_practised
from chemlab.openchem.difficulty import waiting
from chemlab.render.figure import new_figure, save_figure

SCORES = Path(__file__).parent / "results" / "from_nothing.json"
PAGE = Path(__file__).parent.parent.parent / "docs" / "training.md"
FIGURE = PAGE.parent / "images" / "from_nothing.png"
AUDITS = PAGE.parent / "results" / "audits"
SPLIT, EPISODES, PAIRED = "validation", 100, 1000
MANAGERS = ("nothing", "random", "plan", "scripted")
NAMES = ("from-nothing", "team", "in-stages")
"""Names of the sweeps' runs."""
STAGES = "in stages"
"""Stands for the roles of a manager that was trained over benches trained before (``stages.toml``)."""


def means(spec: Scenario, policy: str) -> list[float]:
    """Return the mean score of a policy for each goal."""
    labs = Laboratories(spec, EPISODES, split=SPLIT)
    policies: dict[str, Policy]
    if policy == "nothing":
        policies = {**make_policies("scripted", labs), MANAGER_AGENT: as_policy(waiting(labs))}
    else:
        policies = make_policies(policy, labs)
    return [float(play_laboratory(labs, policies, goal, RESULT_SEED).returns.mean()) for goal in spec.lab_goals]


def gains(spec: Scenario, policy: str) -> dict[str, Any]:
    """Return, by split, what the scripted agents score, and how much higher a policy scores in the same episodes."""
    found = {}
    for split in ("validation", "test"):
        scripted, own = evaluate(Target(spec, split=split), [policy], PAIRED, RESULT_SEED)["policies"]
        found[split] = {"scripted": scripted["mean"]["value"], **own["difference"]}
    return found


def alone(spec: Scenario, bench: str, policy: str) -> dict[str, Any]:
    """Return what a bench scores in experiments of its own, and how much more than the scripted one in the same."""
    target, goals = Target(spec, bench, split=SPLIT), goals_practised(spec, bench)
    found = evaluate(target, [policy], PAIRED, RESULT_SEED, goals)["policies"]
    return {"scripted": found[0]["mean"]["value"], "learned": found[1]["mean"]["value"], "gain": found[1]["difference"]}


def untrained(name: str, plans: int) -> dict[str, float]:
    """Return the score of each untrained manager."""
    spec = load_scenario(name)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "plan.json"
        write_json(file, search_plan(spec, budget=plans).as_file("from_nothing.py", 2).model_dump())
        names = {"random": "scripted,manager=random", "plan": f"scripted,manager=plan:{file}"}
        return {one: statistics.mean(means(spec, names.get(one, one))) for one in MANAGERS}


def is_own(run: Run) -> bool:
    """Return True if a run is of these sweeps, by its folder ``TASK/NAME/seed-N``."""
    return run.path.parent.name in NAMES


def learned(run: Run) -> dict[str, Any]:
    """Return what a finished run has reached."""
    config, result = run.config(), run.result()
    assert config is not None
    assert result is not None
    scenario = config["scenario"]
    roles = config["bench"] if config["background"] == "scripted" else STAGES
    own = {"scenario": scenario, "roles": roles, "seed": result.seed, "steps": result.steps}
    spec = load_scenario(scenario)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*has changed since it was trained")  # the budget has
        score, unpaid = (statistics.mean(means(one, str(run.path))) for one in (spec, without_instruments(spec)))
    if spec.world.draws and not spec.level:
        episodes = json.loads((AUDITS / f"{scenario}.json").read_text(encoding="utf-8"))["budget_episodes"]
        asked = {"policy": str(run.path), "seed": AUDIT_SEED, "episodes": episodes, "split": "test"}
        played = JobRunner(spec, budget_of("small")).run([Job("audit", "play", asked)])
        own["audited"] = statistics.mean(played["audit"]["scores"])
        own["gains"] = gains(spec, str(run.path))
    if learners(roles) == "benches":
        own["alone"] = {bench: alone(spec, bench, str(run.path)) for bench in roles.split(",")}
    found = {
        "best_step": result.best_step,
        "updates": len(run.curve()),
        "best": score,
        "unpaid": unpaid,
        "last": result.last_mean,
    }
    return {**own, **found, "sampled": result.sampled, **curve(run)}


def curve(run: Run) -> dict[str, Any]:
    """Return a run's evaluations (millions of steps, mean score), and the scripted agents' score on their episodes."""
    found = run.evaluations()
    points = " ".join(f"{one.step / 1e6:.3f}:{one.mean:.3f}" for one in found)
    return {"evaluations": points, "beside": found[0].scripted_mean}


def table(scores: dict[str, Any]) -> list[str]:
    """Return the lines of the table: medians over the seeds of training, and the worst where there are several."""
    rows, numbers = [], (*MANAGERS, "learned", "unpaid", "last", "steps of best, of all", "updates", "seeds")
    keys = sorted({(run["scenario"], len(run["roles"]), run["roles"]) for run in scores["runs"]})
    for scenario, _, roles in keys:
        runs = [run for run in scores["runs"] if (run["scenario"], run["roles"]) == (scenario, roles)]
        cells = [f"{scores['untrained'][scenario][one]:.3f}" for one in MANAGERS]
        for name in ("best", "unpaid", "last"):
            values = [run[name] for run in runs if name in run]
            worst = f" ({min(values):.3f})" if len(values) > 1 else ""
            cells.append(f"{statistics.median(values):.3f}{worst}" if values else "")
        best, steps = (statistics.median(run[name] for run in runs) for name in ("best_step", "steps"))
        counts = [run["updates"] for run in runs if "updates" in run]
        updates = f"{statistics.median(counts):,.0f}" if counts else ""
        rows.append([f"`{scenario}`", learners(roles), *cells, f"{best:,.0f} of {steps:,.0f}", updates, str(len(runs))])
    return markdown_table({"scenario": False, "learners": False, **dict.fromkeys(numbers, True)}, rows)


def ladder(scores: dict[str, Any]) -> list[str]:
    """Return the lines of the table of learned scores as multiples of the scripted one, one for each training seed."""
    groups, rows = ("benches", "manager", f"all roles, {STAGES}", "all roles"), []
    for scenario in (*world_scenarios(), "wurtz_dodecane"):
        runs = sorted((run for run in scores["runs"] if run["scenario"] == scenario), key=lambda run: run["seed"])
        cells = [[f"{multiple(run, scores):.2f}" for run in runs if learners(run["roles"]) == who] for who in groups]
        rows.append([f"`{scenario}`", *(", ".join(cell) or "open" for cell in cells)])
    return markdown_table(dict.fromkeys(("scenario", *groups), False), rows)


def multiple(run: dict[str, Any], scores: dict[str, Any]) -> float:
    """Return a run's score in ``validation`` as a multiple of the scripted one in the same episodes."""
    found = run.get("gains", {}).get("validation")
    if found is None:
        return float(run["best"] / scores["untrained"][run["scenario"]]["scripted"])
    return float(1.0 + found["value"] / found["scripted"])


def compared(scores: dict[str, Any]) -> list[str]:
    """Return the lines of the table of gains over the scripted agents."""
    rows, numbers = [], ("seed", "scripted", "gain in `validation`", "in `test`")
    runs = [run for run in scores["runs"] if "gains" in run]
    for run in sorted(runs, key=lambda run: (run["scenario"], len(run["roles"]), run["seed"])):
        found = run["gains"]
        cells = [str(run["seed"]), f"{found['validation']['scripted']:.3f}"]
        cells += [interval_text(found[split], sign="+") for split in ("validation", "test")]
        rows.append([f"`{run['scenario']}`", learners(run["roles"]), *cells])
    return markdown_table({"scenario": False, "learners": False, **dict.fromkeys(numbers, True)}, rows)


def benches(scores: dict[str, Any]) -> list[str]:
    """Return the lines of the table of benches in experiments of their own."""
    rows = []
    for run in sorted(scores["runs"], key=lambda run: (run["scenario"], run["seed"])):
        for bench, one in run.get("alone", {}).items():
            cells = [str(run["seed"]), *(f"{one[who]:.3f}" for who in ("scripted", "learned"))]
            rows.append([f"`{run['scenario']}`", bench, *cells, interval_text(one["gain"], sign="+")])
    numbers = ("seed", "scripted", "learned", "gain")
    return markdown_table({"scenario": False, "bench": False, **dict.fromkeys(numbers, True)}, rows)


def learners(roles: str) -> str:
    """Return who learned in words."""
    if roles == STAGES:
        return f"all roles, {STAGES}"
    return "manager" if roles == "manager" else "all roles" if "manager" in roles.split(",") else "benches"


def draw(scores: dict[str, Any], path: Path) -> None:
    """Draw the evaluations of managers where parameters are hidden, every seed a line, and the scripted agents'."""
    managers = [run for run in scores["runs"] if run["roles"] == "manager" and "audited" in run]
    hidden = sorted({run["scenario"] for run in managers})
    columns, rows = 4, -(-len(hidden) // 4)
    figure = new_figure(2.2 * columns, 1.8 * rows)
    for i, scenario in enumerate(hidden):
        axes = figure.add_subplot(rows, columns, i + 1)
        for run in managers:
            if run["scenario"] == scenario:
                points = [[float(number) for number in point.split(":")] for point in run["evaluations"].split()]
                axes.plot(*zip(*points, strict=True), color="#0072B2")
                axes.axhline(run["beside"], ls="--", color="black", lw=1.2)
        axes.set_title(scenario)
        axes.set_xlim(left=0.0)
        axes.grid(alpha=0.25)
        if i + columns >= len(hidden):  # nothing below
            axes.set_xlabel("million steps")
        if i % columns == 0:
            axes.set_ylabel("raw score")
    figure.tight_layout()
    save_figure(figure, path)


def main() -> None:
    """Play, if asked, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", nargs="?", type=Path, help="runs to play")
    parser.add_argument("--plans", type=int, default=1000, help="open-loop plans tried (default: %(default)s)")
    asked = parser.parse_args()
    scores = json.loads(SCORES.read_text(encoding="utf-8")) if SCORES.exists() else {"untrained": {}, "runs": []}
    for run in [] if asked.results is None else find_runs(asked.results):
        if run.result() is None or not is_own(run):
            continue
        new = learned(run)
        if new["scenario"] not in scores["untrained"]:
            scores["untrained"][new["scenario"]] = untrained(new["scenario"], asked.plans)
        same = {(new["scenario"], new["roles"], new["seed"])}
        scores["runs"] = [old for old in scores["runs"] if (old["scenario"], old["roles"], old["seed"]) not in same]
        scores["runs"].append(new)
        print(json.dumps(new), json.dumps(scores["untrained"][new["scenario"]]), flush=True)
        write_json(SCORES, scores)
    replace_between(PAGE, "from nothing", table(scores))
    replace_between(PAGE, "ladder", ladder(scores))
    replace_between(PAGE, "gains", compared(scores))
    replace_between(PAGE, "benches alone", benches(scores))
    draw(scores, FIGURE)


if __name__ == "__main__":
    main()
