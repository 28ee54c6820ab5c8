"""The command evaluate: policies on the same seeds."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from ..config.files import check_marks, replace_between, write_text
from .options import AddressOption, ForceOption, JsonOption, SeedOption, SplitOption, TrustOption, app, check_result
from .screen import counting, out, plain, show_table

RESULT_COLUMNS: tuple[str, ...] = (
    "scenario",
    "policy",
    "submitted (mol)",
    "purity",
    "score",
    "manager actions",
    "ticks",
    "spill, vent, metal fire",
)
"""Column heads of the results of laboratories."""


_MEASURES = {
    "submitted_mol": "mol submitted",
    "instruments": "cost of measurements",
    "manager_actions": "actions of the manager",
    "unsafe": "share with spill, vent or metal fire",
    "limit": "share that ran out of time",
    "nothing": "share without a submission",
}
"""Measures of a laboratory in words."""


@app.command()
def evaluate(
    targets: Annotated[
        list[str] | None,
        typer.Argument(help="Scenarios, or environment ids of single benches. Default: all bundled scenarios."),
    ] = None,
    policy: Annotated[
        list[str] | None,
        typer.Option(
            help="scripted, random, pretrained, a bundled policy, or the path of a training run, a checkpoint or "
            "exported weights; :greedy or :sampled after a learned one; repeatable. Laboratories accept more, see "
            "`chemlab run`. Default: scripted and random."
        ),
    ] = None,
    bench: Annotated[str | None, typer.Option(help="A bench of the scenario. Default: the whole laboratory.")] = None,
    goal: Annotated[
        list[str] | None,
        typer.Option(
            help="A goal; repeatable. Default: all goals of a bench; in a laboratory each episode draws its goals."
        ),
    ] = None,
    starts: Annotated[str, typer.Option(help="Initial states of a single bench: paper, lab or both.")] = "paper",
    episodes: Annotated[int, typer.Option(min=1, help="Episodes per goal.")] = 100,
    seed: SeedOption = 0,
    split: SplitOption = "train",
    baseline: Annotated[str, typer.Option(help="Baseline of the probability of improvement.")] = "scripted",
    processes: Annotated[
        int | None, typer.Option(min=1, help="Number of concurrent jobs. Default: one, or on a cluster one per core.")
    ] = None,
    address: AddressOption = None,
    output: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Also write all results, with each episode's return, as JSON lines."),
    ] = None,
    force: ForceOption = False,
    update: Annotated[
        Path | None, typer.Option(help="Markdown file whose table of results is updated with the rows of laboratories.")
    ] = None,
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Evaluate policies on the same seeds, with 95 % confidence intervals.

    The interquartile mean is taken over all episodes. P(improvement) is the share of episodes in which the policy
    scores above the baseline with the same seed; a tie counts one half.
    """
    from ..agents.evaluate.play import evaluate as play
    from ..agents.evaluate.play import find_target
    from ..agents.executors import executor
    from ..config.inherit import scenario_names

    policies = policy or ["scripted", "random"]
    if output is not None:
        check_result(output, force, *(targets or ()), baseline, *policies)
    if update is not None:
        check_marks(update, "results")
        check_result(update, True, *(targets or ()), baseline, *policies)
    chosen = [find_target(name, bench, starts, split) for name in targets or scenario_names()]
    for target in chosen if len(chosen) > 1 else ():
        for name in (baseline, *policies):
            target.check(name)
    total = len({baseline, *policies}) * sum(len(goal or target.default_goals) for target in chosen) * episodes
    found = []
    # Most evaluations end before other processes would have started.
    with counting() as progress, executor(address, processes or (1 if address is None else None)) as jobs:
        task = progress.add_task("episodes", total=total)
        for target in chosen:
            found.append(
                play(target, policies, episodes, seed, goal, baseline, lambda n: progress.advance(task, n), jobs)
            )
    cells = [_cells(results["target"], row) for results in found for row in results["policies"] if row["measures"]]
    try:
        for results in found:
            if as_json:
                brief = [{k: v for k, v in row.items() if k not in ("returns", "cases")} for row in results["policies"]]
                typer.echo(json.dumps({**results, "policies": brief}))
            else:
                _show(results)
        if not as_json and len(found) > 1 and cells:
            show_table("Means of episodes", RESULT_COLUMNS, cells, right=range(2, len(RESULT_COLUMNS)))
    finally:  # also if printing fails
        if output is not None:
            write_text(output, "".join(json.dumps(results, separators=(",", ":")) + "\n" for results in found))
        if update is not None:
            _update(update, cells, whole=not targets)
    if output is not None and not as_json:
        out.print(f"wrote {plain(output)}")


def _cells(target: Mapping[str, Any], row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the cells of a policy's results in a laboratory, by ``RESULT_COLUMNS``."""
    means = row["measures"]
    return (
        target["scenario"],
        row["policy"],
        *(f"{value:.3f}" for value in (means["submitted_mol"], means["purity"], row["mean"]["value"])),
        *(f"{value:.1f}" for value in (means["manager_actions"], row["mean_length"])),
        f"{means['unsafe']:.0%} of episodes",
    )


def _update(page: Path, cells: Sequence[tuple[str, ...]], whole: bool) -> None:
    """Write rows between a Markdown file's marks; rows of other scenarios are kept unless the table is complete."""
    text, start, stop = check_marks(page, "results")
    found = {} if whole else {_row_of(line): line for line in text[start:stop].splitlines() if line.startswith("| `")}
    found |= {(name, played): f"| `{name}` | {' | '.join((played, *others))} |" for name, played, *others in cells}
    lines = ["| " + " | ".join(RESULT_COLUMNS) + " |", "|---|---" + "|--:" * (len(RESULT_COLUMNS) - 2) + "|"]
    replace_between(page, "results", lines + [line for _, line in sorted(found.items())])


def _row_of(line: str) -> tuple[str, str]:
    """Return scenario and policy of a table row."""
    scenario, policy, *_ = (cell.strip() for cell in line.strip("|").split("|"))
    return scenario.strip("`"), policy


def _show(results: dict[str, Any]) -> None:
    """Print an evaluation over all goals, then by goal."""
    from ..agents.evaluate.play import notes
    from ..agents.evaluate.statistics import interval_text

    target, rows = results["target"], results["policies"]
    names = [row["policy"] for row in rows]
    what = f"{target['scenario']}, bench {target['bench']}" if target["bench"] else f"{target['scenario']}, laboratory"
    each = " per goal" if len(results["goals"]) > 1 else ""
    title = f"{what}: {results['episodes_per_goal']} episodes{each}; [{results['confidence']:.0%} intervals]"
    whole = []
    for row in rows:
        mean, middle, gain = (interval_text(row[key]) for key in ("mean", "interquartile_mean", "difference"))
        beside = ("", "") if row["policy"] == results["baseline"] else (gain, interval_text(row["improvement"], 2))
        whole.append((row["policy"], mean, middle, *beside, f"{row['mean_length']:.1f}"))
    length = "steps" if target["bench"] else "ticks"
    head = ("policy", "mean", "interquartile mean", f"minus {results['baseline']}", "P(improvement)", length)
    show_table(title, head, whole, right=range(1, 6))
    for key, kind in (("by_goal", "goal"), ("by_case", "starting state")):
        if len(rows[0][key]) > 1:
            cells = [
                [case, *(interval_text(row[key][case].get("mean", row[key][case])) for row in rows)]
                for case in rows[0][key]
            ]
            show_table(f"mean return by {kind}", (kind, *names), cells, right=range(1, len(rows) + 1))
    for note in notes(results):
        out.print(plain(note))
    if rows[0]["measures"]:
        cells = [
            [_MEASURES.get(name, name), *(f"{row['measures'][name]:.3f}" for row in rows)]
            for name in rows[0]["measures"]
        ]
        show_table("means of episodes", ("", *names), cells, right=range(1, len(rows) + 1))
