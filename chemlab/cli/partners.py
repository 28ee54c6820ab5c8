"""The command crossplay: managers with unseen partners."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..config.files import check_folder
from .options import (
    AddressOption,
    ForceOption,
    JsonOption,
    ProcessesOption,
    ScenarioArgument,
    SplitOption,
    TrustOption,
    app,
    check_result,
    report_result,
    resumable,
)
from .screen import counting, page, show_table


@app.command()
def crossplay(
    scenario: ScenarioArgument,
    manager: Annotated[
        list[str] | None,
        typer.Option(
            help="Managers: names as for `chemlab run`, a training run, or a folder of runs; repeatable. "
            "Default: scripted, scripted:unsafe, scripted@0.1 (a random action at one turn in ten)."
        ),
    ] = None,
    benches: Annotated[list[str] | None, typer.Option(help="Policies of the benches, given like --manager.")] = None,
    split: SplitOption = "test",
    budget: Annotated[str, typer.Option(help="Number of episodes, as for `chemlab audit`: small or full.")] = "small",
    keep: Annotated[
        Path | None,
        typer.Option(
            help="Folder of cached results, from which the same command resumes. The folder of an audit, or "
            "parts/SCENARIO of a benchmark, contains the scale."
        ),
    ] = None,
    processes: ProcessesOption = None,
    address: AddressOption = None,
    output: Annotated[Path | None, typer.Option("--out", "-o", help="Also write the results as JSON.")] = None,
    force: ForceOption = False,
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Play each manager with each set of benches, and measure the loss of learned policies with unseen partners.

    Training partners of learned policies are always included. Scores are normalized as in the benchmark, from 0
    (random) to 1 (oracle), in the same worlds.
    """
    from ..agents.evaluate.crossplay import PARTNERS, crossplay_count, find_players
    from ..agents.evaluate.crossplay import crossplay as play
    from ..agents.evaluate.jobs import budget_of
    from ..agents.executors import executor
    from ..config.draws import Split
    from ..config.loading import load_scenario

    Split.of(split)
    spec = load_scenario(scenario)
    chosen = budget_of(budget)
    if keep is not None:
        check_folder(keep)
    if output is not None:
        check_result(output, force, scenario, *(manager or ()), *(benches or ()))
    managers, crews = find_players(spec, manager or PARTNERS, benches or PARTNERS)
    with resumable(keep), counting() as progress, executor(address, processes) as jobs:
        task = progress.add_task("parts", total=crossplay_count(managers, crews, chosen, split))
        found = play(spec, managers, crews, budget, split, keep, jobs, lambda _: progress.advance(task))
    report_result(found, _show, as_json, output)


def _show(found: dict[str, Any]) -> None:
    """Print the benches, the matrix and the gaps."""
    from ..agents.evaluate.statistics import interval_text

    names = [player["name"] for player in found["benches"]]
    letters = {name: f"benches {i + 1}" for i, name in enumerate(names)}
    show_table("", ("", "played by"), [(letter, name) for name, letter in letters.items()])
    cells = {(cell["manager"], cell["benches"]): cell for cell in found["cells"]}
    rows = []
    for name in (player["name"] for player in found["managers"]):
        own = [cells[name, other] for other in names]
        rows.append((name, *(interval_text(cell, 2) + " *" * cell["together"] for cell in own)))
    title = f"{found['scenario']}: {found['budget_episodes']} episodes, split {found['split']}; * trained together"
    show_table(title, ("manager", *letters.values()), rows, right=range(1, len(names) + 1))
    gaps = [
        (
            f"{one['side']} {one['policy']}",
            *(interval_text(one[key], 2) for key in ("with_partner", "with_unseen", "gap")),
        )
        for one in found["gaps"]
    ]
    if gaps:
        show_table(
            "Scores with unseen partners",
            ("who", "with its partner", "with unseen partners", "gap"),
            gaps,
            right=(1, 2, 3),
        )
    page.print("0 is random play, 1 the oracle.")
