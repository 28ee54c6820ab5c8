"""The command benchmark: all policies in the same worlds, on one scale."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from ..config.files import check_folder
from .options import (
    AddressOption,
    JsonOption,
    ProcessesOption,
    SplitOption,
    TrustOption,
    app,
    current_policy,
    resumable,
)
from .screen import counting, out, show_table


@app.command()
def benchmark(
    scenario: Annotated[
        list[str] | None, typer.Argument(help="Scenarios: bundled names or paths. Default: all with hidden parameters.")
    ] = None,
    policy: Annotated[
        list[str] | None,
        typer.Option(
            help="Besides random, plan and oracle: names as for `chemlab run`, a training run, or a folder of "
            "runs that differ in their seeds only, or records of people and language agents; repeatable. "
            "Default: scripted, pretrained, trained."
        ),
    ] = None,
    split: SplitOption = "test",
    seeds: Annotated[int, typer.Option(min=1, help="Replications: worlds and, of runs, training seeds.")] = 5,
    budget: Annotated[str, typer.Option(help="Number of episodes, as for `chemlab audit`: small or full.")] = "small",
    baseline: Annotated[
        str, typer.Option(callback=current_policy, help="Baseline of the probability of improvement.")
    ] = "scripted",
    records: Annotated[int, typer.Option(min=0, help="Recorded episodes per row and scenario.")] = 1,
    processes: ProcessesOption = None,
    address: AddressOption = None,
    output: Annotated[
        Path, typer.Option("--out", "-o", help="Output folder, from which the same command resumes.")
    ] = Path("benchmark"),
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Play the benchmark's protocol: all policies in the same worlds, normalized scores from 0 (random) to 1 (oracle).

    The same command resumes an interrupted benchmark. The folder's leaderboard keeps the rows of other commands.
    """
    from ..agents.evaluate import benchmark as protocol
    from ..agents.evaluate.jobs import budget_of
    from ..agents.evaluate.leaderboard import leaderboard_lines
    from ..agents.executors import executor
    from ..config.draws import Split
    from ..config.loading import load_scenario

    Split.of(split)
    specs = [load_scenario(name) for name in scenario or protocol.world_scenarios()]
    chosen = budget_of(budget)
    always = protocol.REFERENCES
    names = dict.fromkeys([baseline, *(policy or protocol.DEFAULT_ROWS)])
    rows = protocol.find_rows([name for name in names if name not in always])
    protocol.check_rows(specs, [row for row in rows if policy or row.name == baseline])
    check_folder(output)
    leaderboard_lines(output / "leaderboard.json")  # validated before anything is played
    with resumable(output), counting() as progress, executor(address, processes) as jobs:
        total = protocol.part_count(specs, rows, chosen, seeds, split)
        task = progress.add_task("parts", total=total)
        parts = output / "parts"
        found = protocol.benchmark(
            specs, rows, budget, seeds, split, baseline, parts, jobs, lambda _: progress.advance(task)
        )
        protocol.write_benchmark(output, found, specs, rows, records)
    if as_json:
        typer.echo(json.dumps(found))
        return
    _show(found)
    out.print(f"wrote {output}: benchmark.json, marl_eval.json, leaderboard.json, records", markup=False)


def _show(found: dict[str, Any]) -> None:
    """Print a table by scenario, one over all scenarios, and the empty cells."""
    from ..agents.evaluate.statistics import interval_text

    names = list(found["scenarios"])
    cells = {name: found["scenarios"][name]["cells"] for name in names}
    words = [
        [
            row["policy"],
            *(interval_text(c) if (c := cells[name][row["policy"]])["value"] is not None else "" for name in names),
        ]
        for row in found["rows"]
    ]
    title = f"{found['budget_episodes']} episodes per scenario, split {found['split']}; 0 random, 1 oracle"
    show_table(title, ("policy", *names), words, right=range(1, len(names) + 1))
    over = [
        (
            row["policy"],
            str(row["scenarios"]),
            *("" if row[key] is None else interval_text(row[key]) for key in ("interquartile_mean", "mean")),
            "" if row["improvement"] is None else interval_text(row["improvement"], 2),
            "" if row["hours"] is None else f"{row['hours']:.2f}",
        )
        for row in found["rows"]
    ]
    head = ("policy", "scenarios", "interquartile mean", "mean", f"P(better than {found['baseline']})", "hours")
    show_table(f"{found['seeds']} replications; [{found['confidence']:.0%} intervals]", head, over, right=range(1, 6))
    seats = [
        (
            name,
            policy,
            f"{one['condition']}; names {one['names']}",
            *(f"{one[k]:g}" for k in ("calls", "wrong", "tokens")),
        )
        for name in names
        for policy, cell in cells[name].items()
        if (one := cell.get("seats"))
    ]
    if seats:
        head = ("scenario", "policy", "condition", "calls", "refused", "tokens")
        show_table("language agents: means per episode", head, seats, right=range(3, 6))
    # benchmark.json has all cells, with the reason why each known one does not fit.
    reasons = [(n, p, c["reason"].partition(" (")[0]) for n in names for p, c in cells[n].items() if c["value"] is None]
    if reasons:
        show_table("not played", ("scenario", "policy", "why"), reasons)
