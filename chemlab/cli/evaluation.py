"""Commands about results: evaluate, figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from ..files import replace_between, write_text
from .common import JsonOption, SeedOption, app, err, out, readable_errors

__all__: list[str] = []


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=err,
        transient=True,
    )


@app.command()
def evaluate(
    target: Annotated[str, typer.Argument(help="A single bench's environment id, or a scenario (see `chemlab list`).")],
    policy: Annotated[
        list[str] | None,
        typer.Option(
            help="heuristic, random, pretrained, the name of a policy that comes along, or the path of a training run, "
            "of a checkpoint or of exported weights; repeat the option. Laboratories know more, see `chemlab run`. "
            "Default: heuristic and random."
        ),
    ] = None,
    bench: Annotated[str | None, typer.Option(help="A bench of the scenario; without: the whole laboratory.")] = None,
    goal: Annotated[list[str] | None, typer.Option(help="A goal; repeat the option. Default: all.")] = None,
    starts: Annotated[str, typer.Option(help="Starting states of a single bench: paper, lab or both.")] = "paper",
    episodes: Annotated[int, typer.Option(min=1, help="Episodes for each goal.")] = 100,
    seed: SeedOption = 0,
    baseline: Annotated[str, typer.Option(help="The policy that improvement is measured over.")] = "heuristic",
    output: Annotated[
        Path | None, typer.Option("--out", "-o", help="Also write everything, with each episode's return, as JSON.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare policies goal by goal from the same seeds, with bootstrap confidence intervals.

    The interquartile mean is that of all episodes. P(improvement) is the share of episodes in which the policy does
    better than the baseline does from the same seed, a tie counting one half.
    """
    with readable_errors():
        from ..agents.evaluation.play import evaluate as play
        from ..agents.evaluation.play import find_target

        chosen = find_target(target, bench, starts)
        policies = policy or ["heuristic", "random"]
        total = len({baseline, *policies}) * len(goal or chosen.goals) * episodes
        with _progress() as progress:
            task = progress.add_task("episodes", total=total)
            results = play(chosen, policies, episodes, seed, goal, baseline, watch=lambda n: progress.advance(task, n))
        if output is not None:
            write_text(output, json.dumps(results, separators=(",", ":")) + "\n")
    if as_json:
        brief = [{k: v for k, v in row.items() if k not in ("returns", "cases")} for row in results["policies"]]
        typer.echo(json.dumps({**results, "policies": brief}))
        return
    for table in _tables(results):
        Console().print(table)
    if output is not None:
        out.print(f"wrote {output}")


def _interval(estimate: dict[str, float], digits: int = 3) -> str:
    """A statistic and its interval for a table's cell."""
    from ..agents.evaluation.statistics import interval_text

    return escape(interval_text(estimate, digits))


def _tables(results: dict[str, Any]) -> list[Table]:
    """What people see of an evaluation: the whole, then goal by goal."""
    target, rows = results["target"], results["policies"]
    what = f"{target['scenario']}, bench {target['bench']}" if target["bench"] else f"{target['scenario']}, laboratory"
    count, share = results["episodes_per_goal"], results["confidence"]
    whole = Table(title=f"{what}: {count} episodes a goal; [{share:.0%} intervals]".replace("[", r"\["), box=SIMPLE)
    for name in ("policy", "mean", "interquartile mean", f"minus {results['baseline']}", "P(improvement)", "steps"):
        whole.add_column(name, justify="left" if name == "policy" else "right", overflow="fold")
    for row in rows:
        numbers = [_interval(row[key]) for key in ("mean", "interquartile_mean", "difference")]
        same = row["policy"] == results["baseline"]
        cells = [*numbers[:2], "" if same else numbers[2], "" if same else _interval(row["improvement"], 2)]
        whole.add_row(row["policy"], *cells, f"{row['mean_length']:.1f}")
    tables = [whole]
    for key, title in (("by_goal", "goal"), ("by_case", "starting state")):
        keys = list(rows[0][key])
        if len(keys) < 2:
            continue
        table = Table(title=f"mean return by {title}", box=SIMPLE)
        table.add_column(title)
        for row in rows:
            table.add_column(row["policy"], justify="right", overflow="fold")
        for name in keys:
            values = [row[key][name].get("mean", row[key][name]) for row in rows]
            table.add_row(name, *map(_interval, values))
        tables.append(table)
    if rows[0]["measures"]:
        table = Table(title="means of episodes", box=SIMPLE)
        table.add_column("")
        for row in rows:
            table.add_column(row["policy"], justify="right", overflow="fold")
        for name in rows[0]["measures"]:
            table.add_row(name, *(f"{row['measures'][name]:.3f}" for row in rows))
        tables.append(table)
    return tables


@app.command()
def figures(
    results: Annotated[Path, typer.Argument(help="Folder with training runs, as `chemlab sweep` leaves it.")],
    output: Annotated[Path, typer.Option("--out", "-o", help="Where figures and tables go.")] = Path("figures"),
    collect: Annotated[
        bool,
        typer.Option(
            "--collect",
            help="First play the best policies, and store what they do in traces.json, managers' in laboratory.json, "
            "those of the shipped bench policies in benches.json.",
        ),
    ] = False,
    file_format: Annotated[
        list[str] | None, typer.Option("--format", help="png, svg or pdf; repeat the option. Default: png.")
    ] = None,
    update: Annotated[
        list[Path] | None,
        typer.Option(help="Replace the tables between their marks in this Markdown file; repeat the option."),
    ] = None,
) -> None:
    """Draw the paper's figures from training runs, and tables of its results beside ours.

    Where managers of laboratories were trained there is a table and a figure of theirs, too (laboratory.md).

    Needs nothing but results files (and the extra `plot`); --collect also needs the runs' checkpoints.
    """
    with readable_errors():
        from ..agents.evaluation.benches import bench_policies, benches_table, collect_benches
        from ..agents.evaluation.figures import FIGURES, write_figures
        from ..agents.evaluation.laboratory import brief_table, collect_laboratories, laboratory_count, write_laboratory
        from ..agents.evaluation.results import read_results
        from ..agents.evaluation.summary import paper_table, write_summary

        for file in update or ():
            if not file.is_file():
                raise ValueError(f"--update: {file}: no such file; it needs the marks between which tables stand")
        found = read_results(results)
        formats = file_format or ["png"]
        with _progress() as progress:
            if collect:
                from ..agents.evaluation.traces import collect_traces, trace_count

                task = progress.add_task("policies", total=trace_count(found))
                collect_traces(found, watch=lambda _: progress.advance(task))
                task = progress.add_task("managers", total=laboratory_count(results))
                collect_laboratories(results, watch=lambda _: progress.advance(task))
                task = progress.add_task("shipped benches", total=len(bench_policies()))
                collect_benches(results, watch=lambda _: progress.advance(task))
                found = read_results(results)
            task = progress.add_task("figures", total=len(FIGURES))
            lacking = write_figures(found, output, formats, lambda _: progress.advance(task))
        page, _ = write_summary(found, output, lacking, formats)
        laboratory = write_laboratory(results, output, formats)
        tables = {
            "managers": lambda: brief_table(results, shipped=True),
            "measuring": lambda: brief_table(results, shipped=False),
            "benches": lambda: benches_table(results),
            "paper": lambda: paper_table(found),
        }
        for file in update or ():
            marks = [mark for mark in tables if f"<!-- {mark}: begin -->" in file.read_text(encoding="utf-8")]
            for mark in marks or ["managers"]:
                replace_between(file, mark, tables[mark]())
    for stem, missing in lacking.items():
        out.print(f"{stem}: {'missing: ' + '; '.join(missing) if missing else 'complete'}")
    for line in (*found.left_out, *(laboratory.left_out if laboratory is not None else ())):
        out.print(f"[yellow]left out[/yellow] {escape(line)}")
    for written in (page, *([laboratory.page] if laboratory is not None else [])):
        out.print(f"wrote {written}")
