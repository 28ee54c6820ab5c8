"""The command audit: requirements of a scenario, its best open-loop plan, and its difficulty."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..config.files import check_folder
from .options import (
    AddressOption,
    DefaultGroup,
    EpisodesOption,
    ForceOption,
    JsonOption,
    ProcessesOption,
    ScenarioArgument,
    SeedOption,
    TrustOption,
    app,
    check_result,
    current_policy,
    report_result,
    resumable,
)
from .screen import counting, err, out, plain, show_table

if TYPE_CHECKING:
    from ..agents.evaluate.plans import PlanSearch
    from ..agents.open_loop import PlanFile

audit = typer.Typer(
    cls=DefaultGroup,
    help="Measure the requirements of a scenario (`chemlab audit SCENARIO`), its open-loop plan, or its difficulty.",
    no_args_is_help=True,
)
app.add_typer(audit, name="audit")


@audit.command()
def measures(
    scenario: ScenarioArgument,
    budget: Annotated[str, typer.Option(help="Numbers of episodes and plans: small or full.")] = "small",
    turns: Annotated[
        int | None, typer.Option(min=0, help="Training turns of each learner; 0: no learners. Default: the budget's.")
    ] = None,
    keep: Annotated[
        Path | None,
        typer.Option(help="Folder of cached results, from which the same command resumes."),
    ] = None,
    processes: ProcessesOption = None,
    address: AddressOption = None,
    output: Annotated[Path | None, typer.Option("--out", "-o", help="Also write the results as JSON.")] = None,
    force: ForceOption = False,
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Measure the value of observations, instruments, benches, roles and planning, against open-loop policies.

    Scores are normalized: 0 is random legal play, 1 the oracle, a planner that knows the hidden parameters.
    Acceptance criteria apply to scenarios with hidden parameters.
    """
    from ..agents.evaluate.audit import audit as measure
    from ..agents.evaluate.audit import job_count
    from ..agents.evaluate.jobs import budget_of
    from ..agents.executors import executor
    from ..config.loading import load_scenario

    spec = load_scenario(scenario)
    chosen = budget_of(budget, turns)
    if keep is not None:
        check_folder(keep)
    if output is not None:
        check_result(output, force, scenario)
    with resumable(keep), counting() as progress, executor(address, processes) as jobs:
        task = progress.add_task("parts", total=job_count(spec, chosen))
        found = measure(spec, budget, keep, jobs, lambda _: progress.advance(task), turns)
    report_result(found, _show, as_json, output)


def _show(found: dict[str, Any]) -> None:
    """Print the measures, the acceptance criteria and a verdict."""
    from ..agents.evaluate.audit import CRITERIA, measure_rows, verdict

    if "impossible" not in found:
        title = f"{found['scenario']}: {found['budget_episodes']} episodes; 0 random, 1 planner's lower bound"
        show_table(title, ("measure", "value [95 % interval]", "by"), measure_rows(found))
        words = {True: "met", False: "not met", None: "does not apply"}
        criteria = [(name, CRITERIA[name], words[met]) for name, met in found["criteria"].items()]
        show_table("Acceptance criteria", ("criterion", "requires", ""), criteria)
    out.print(verdict(found), markup=False)


@audit.command()
def plan(
    scenario: ScenarioArgument,
    benches: Annotated[
        str,
        typer.Option(callback=current_policy, help="Policy of the benches, named as for `chemlab run`."),
    ] = "scripted",
    budget: Annotated[int, typer.Option(help="Maximum number of plans tried.")] = 10_000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search.")] = 0,
    episodes: EpisodesOption = 100,
    output: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Also write the plans; play them with --policy BENCHES,manager=plan:FILE."),
    ] = None,
    force: ForceOption = False,
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Search for the best open-loop plan of the manager, one for each combination of goals.

    In a scenario that requires observations, other policies score higher. The score is over episodes with seeds 0, 1,
    ..., which the search does not use.
    """
    from ..agents.evaluate.search import search_plan
    from ..config.loading import load_scenario

    spec = load_scenario(scenario)
    if output is not None:
        if found := re.search("[,=@]", str(output)):
            raise ValueError(
                f"--out: {output}: --policy plan:FILE cannot name a file with {found[0]!r}; give another name"
            )
        check_result(output, force, scenario, benches)
    words = ["chemlab", "audit", "plan", scenario, "--benches", benches, "--budget", str(budget), "--seed", str(seed)]
    trusting = ["--trust"] if trust else []
    words += ["--episodes", str(episodes), *trusting]
    with counting() as progress:
        task = progress.add_task("plans", total=budget)
        search = search_plan(spec, benches, budget, seed, watch=lambda n: progress.advance(task, n))
        plans = search.as_file(shlex.join(words), episodes)
    report_result(plans.model_dump(), lambda _: _tell(search, plans), as_json, output)
    if output is not None and not as_json:
        words = ["chemlab", "run", scenario, "--policy", f"{benches},manager=plan:{output}"]
        out.print(f"wrote {plain(output)}; play it: {plain(shlex.join([*words, *trusting]))}")


def _tell(search: PlanSearch, found: PlanFile) -> None:
    """Print every plan in words, and the score."""
    from ..agents.evaluate.plans import plan_words
    from ..agents.evaluate.statistics import interval_text

    for one in search.found:
        out.print(f"[bold]{plain(', '.join(one.context))}[/bold]: score {one.score:.3f}")
        for number, line in enumerate(plan_words(search.scenario, one.team.plan), start=1):
            out.print(f"  {number}. {plain(line)}")
    score = interval_text(found.evaluation)
    out.print(
        f"score {score}, mean of {found.evaluation['episodes']} episodes; benches: {found.benches}; "
        f"{found.tried:,} plans tried",
        markup=False,
    )


@audit.command()
def difficulty(
    scenario: ScenarioArgument,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of the scripted agents per goal.")] = 20,
    plans: Annotated[int, typer.Option(min=0, help="Open-loop plans tried per goal; 0: no search.")] = 100,
    explored: Annotated[int, typer.Option(min=1, help="Episodes of a random manager per goal.")] = 200,
    seed: SeedOption = 0,
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Measure the difficulty of a scenario: its chemistry, scores, and what random exploration finds.

    Yield and selectivity are those of the best constant conditions of the reaction bench: a temperature, and an
    addition of reagents at once or slowly.
    """
    from ..config.loading import load_scenario
    from ..openchem.difficulty import difficulty as measure

    spec = load_scenario(scenario)
    with err.status(plain(spec.name)):
        rows = measure(spec, episodes, plans, seed, explored)
    if as_json:
        typer.echo(json.dumps([asdict(row) for row in rows]))
        return
    shown = []
    for row in rows:
        c = row.conditions
        slowly = f", {' and '.join(c.slowly)} slowly" if c is not None and c.slowly else ""
        shown.append(
            (
                row.goal,
                str(row.steps),
                "none" if c is None else f"{c.reached:.2f}",
                "none" if c is None else f"{c.selectivity:.2f}",
                "" if c is None else f"{c.temperature_k:g} K{slowly}",
                "" if row.boils_apart_k is None else f"{row.boils_apart_k:g} K to {row.boils_next}",
                f"{row.scripted:.2f}",
                "" if row.plan is None else f"{row.plan:.2f}",
            )
        )
    head = ("goal", "steps", "yield", "selectivity", "at", "boils apart", "scripted", "constant plan")
    show_table(f"{spec.name}: difficulty of its goals", head, shown, right=(1, 2, 3, 6, 7))
    found = [(row.goal, f"{row.nothing:.3f}", f"{row.chance:.1%}", f"{row.decisions:.0f}") for row in rows]
    title = f"{spec.name}: exploration, {explored} episodes of a random manager"
    show_table(title, ("goal", "doing nothing", "random above 0.1", "decisions"), found, right=(1, 2, 3))
