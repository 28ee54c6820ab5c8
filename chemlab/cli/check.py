"""The command check: conformance of a scenario and of the parts that it names."""

from __future__ import annotations

import json
from dataclasses import asdict

import typer

from .options import JsonOption, ScenarioArgument, TrustOption, app
from .screen import counting, err, out, plain


@app.command()
def check(scenario: ScenarioArgument, trust: TrustOption = False, as_json: JsonOption = False) -> None:
    """Check that a scenario, with the benches, operations and instruments that it names, conforms to the interfaces.

    Plays random legal actions and tests spaces, limits, seeds, copies, conservation, records, and the agreement of all
    environments. Exits with 0 if every check passes, and with 1 if one fails. Warns of probable mistakes.
    """
    from ..config.loading import load_scenario
    from ..conformance import CHECKS, check_scenario, doubts

    spec = load_scenario(scenario)
    for doubt in doubts(spec):
        err.print(f"[yellow]warning[/yellow]: {plain(doubt)}")
    results = []
    with counting() as progress:
        task = progress.add_task("checks", total=len(CHECKS))
        for result in check_scenario(spec):
            results.append(result)
            progress.advance(task)
            if not as_json:
                word = "[red]failed[/red]" if result.error else "[green]passed[/green]"
                out.print(f"{word} {result.name}: {plain(result.error or result.meaning)}")
    if as_json:
        typer.echo(json.dumps([asdict(result) for result in results]))
    raise typer.Exit(int(any(result.error for result in results)))
