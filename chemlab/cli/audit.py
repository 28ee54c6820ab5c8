"""The command audit: what a scenario asks of its agents."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from ..config.files import check_folder, write_text
from .common import (
    AddressOption,
    JsonOption,
    ProcessesOption,
    ScenarioArgument,
    app,
    check_result,
    out,
    readable_errors,
)
from .screen import counting, show_table

__all__: list[str] = []


@app.command()
def audit(
    scenario: ScenarioArgument,
    budget: Annotated[str, typer.Option(help="How much is played: small (two minutes) or full (thirty).")] = "small",
    keep: Annotated[
        Path | None,
        typer.Option(help="Folder for the results of finished parts: the same command goes on from there."),
    ] = None,
    processes: ProcessesOption = None,
    address: AddressOption = None,
    output: Annotated[Path | None, typer.Option("--out", "-o", help="Also write the findings as JSON.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Measure whether a scenario asks for eyes, instruments, benches and planning, or whether a blind plan does.

    Scores are normalised: 0 is random legal play, 1 what a planner reaches that knows every episode's world. A gate is
    what a scenario with a world has to prove.
    """
    with readable_errors():
        from ..agents.evaluate.audit import audit as measure
        from ..agents.evaluate.audit import job_count
        from ..agents.evaluate.jobs import budget_of
        from ..agents.executors import executor
        from ..config.scenario import load_scenario

        spec = load_scenario(scenario)
        chosen = budget_of(budget)
        if keep is not None:
            check_folder(keep)
        if output is not None:
            check_result(output, scenario)
        with counting() as progress, executor(address, processes) as jobs:
            task = progress.add_task("parts", total=job_count(spec, chosen))
            found = measure(spec, budget, keep, jobs, lambda _: progress.advance(task))
    if as_json:
        typer.echo(json.dumps(found))
    else:
        _show(found)
    if output is not None:
        write_text(output, json.dumps(found, indent=1) + "\n")


def _show(found: dict[str, Any]) -> None:
    """What people see: the measures, the gates, a sentence."""
    from ..agents.evaluate.audit import GATES, measure_rows, verdict

    title = (
        f"{found['scenario']}: {found['budget_episodes']} episodes, reference {found['policy']}; 0 random, 1 knows all"
    )
    show_table(title, ("measure", "value [95 % interval]", "by"), measure_rows(found))
    words = {True: "met", False: "not met", None: "does not apply"}
    gates = [(name, GATES[name], words[met]) for name, met in found["gates"].items()]
    show_table("Gates", ("gate", "asks for", ""), gates)
    out.print(verdict(found), markup=False)
