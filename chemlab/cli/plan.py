"""The command plan: the best that a blind manager does."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .common import (
    EpisodesOption,
    JsonOption,
    ScenarioArgument,
    SeedOption,
    TrustOption,
    app,
    check_result,
    current_policy,
    out,
    readable_errors,
)
from .screen import counting, plain

if TYPE_CHECKING:
    from ..agents.evaluate.plans import PlanSearch
    from ..agents.plans import PlanFile

__all__: list[str] = []


@app.command()
def plan(
    scenario: ScenarioArgument,
    benches: Annotated[
        str,
        typer.Option(
            callback=current_policy, help="Who operates the benches, which see: as --policy of `chemlab run`."
        ),
    ] = "scripted",
    budget: Annotated[
        str, typer.Option(help="Most plans tried: small (10,000), full (100,000) or a number.")
    ] = "small",
    seed: SeedOption = 0,
    episodes: EpisodesOption = 100,
    output: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Also write the plans, to be played with --policy BENCHES,manager=plan:FILE."),
    ] = None,
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Search for the best constant plan: what a manager reaches that never looks.

    A scenario that asks for anything must be worth more to those who look. For each combination of goals there is a
    plan of its own. The score is that of episodes with seeds 0, 1, ..., which the search has not seen.
    """
    with readable_errors():
        from ..agents.evaluate.plans import plan_budget, search_plan
        from ..config.scenario import load_scenario

        spec = load_scenario(scenario)
        most = plan_budget(budget)
        if output is not None:
            check_result(output, scenario, benches)
        with counting() as progress:
            task = progress.add_task("plans", total=most)
            search = search_plan(spec, benches, most, seed, watch=lambda n: progress.advance(task, n))
        words = ["chemlab", "plan", scenario, "--benches", benches, "--budget", budget, "--seed", str(seed)]
        words += ["--episodes", str(episodes)]
        found = search.as_file(shlex.join(words), episodes)
    if as_json:
        typer.echo(json.dumps(found.as_dict()))
    else:
        _tell(search, found)
    if output is not None:
        found.save(output)
        if not as_json:
            run = shlex.join(["chemlab", "run", scenario, "--policy", f"{benches},manager=plan:{output}"])
            out.print(f"wrote {plain(output)}; play it: {plain(run)}")


def _tell(search: PlanSearch, found: PlanFile) -> None:
    """What people see: every plan in words, and the score."""
    from ..agents.evaluate.plans import plan_words
    from ..agents.evaluate.statistics import interval_text

    for one in search.found:
        out.print(f"[bold]{plain(', '.join(one.context))}[/bold]: score {one.score:.3f}")
        for number, line in enumerate(plan_words(search.scenario, one.plan), start=1):
            out.print(f"  {number}. {plain(line)}")
    score = interval_text(found.evaluation)
    out.print(
        f"score {score}, mean of {found.evaluation['episodes']} episodes; benches: {found.benches}; "
        f"{found.tried:,} plans tried",
        markup=False,
    )
