"""Commands about results: evaluate, figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from ..config.files import check_folder, write_text
from .common import (
    AddressOption,
    JsonOption,
    SeedOption,
    SplitOption,
    TrustOption,
    app,
    check_result,
    out,
    readable_errors,
)
from .screen import counting, plain, show_table

__all__: list[str] = []


@app.command()
def evaluate(
    target: Annotated[str, typer.Argument(help="A single bench's environment id, or a scenario (see `chemlab list`).")],
    policy: Annotated[
        list[str] | None,
        typer.Option(
            help="scripted, random, pretrained, the name of a policy that comes along, or the path of a training run, "
            "of a checkpoint or of exported weights; repeat the option. Laboratories know more, see `chemlab run`. "
            "Default: scripted and random."
        ),
    ] = None,
    bench: Annotated[str | None, typer.Option(help="A bench of the scenario; without: the whole laboratory.")] = None,
    goal: Annotated[list[str] | None, typer.Option(help="A goal; repeat the option. Default: all.")] = None,
    starts: Annotated[str, typer.Option(help="Starting states of a single bench: paper, lab or both.")] = "paper",
    episodes: Annotated[int, typer.Option(min=1, help="Episodes for each goal.")] = 100,
    seed: SeedOption = 0,
    split: SplitOption = "train",
    baseline: Annotated[str, typer.Option(help="The policy that improvement is measured over.")] = "scripted",
    processes: Annotated[
        int | None, typer.Option(min=1, help="Jobs at a time. Default: one, or, of a cluster, one for each core.")
    ] = None,
    address: AddressOption = None,
    output: Annotated[
        Path | None, typer.Option("--out", "-o", help="Also write everything, with each episode's return, as JSON.")
    ] = None,
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Compare policies goal by goal from the same seeds, with 95 % confidence intervals.

    The interquartile mean is that of all episodes. P(improvement) is the share of episodes in which the policy does
    better than the baseline does from the same seed, a tie counting one half.
    """
    with readable_errors():
        from ..agents.evaluate.play import evaluate as play
        from ..agents.evaluate.play import find_target
        from ..agents.executors import executor

        if output is not None:
            check_result(output, target, baseline, *(policy or ()))
        chosen = find_target(target, bench, starts, split)
        policies = policy or ["scripted", "random"]
        total = len({baseline, *policies}) * len(goal or chosen.goals) * episodes
        # Most evaluations are over before other processes would have started.
        with counting() as progress, executor(address, processes or (1 if address is None else None)) as jobs:
            task = progress.add_task("episodes", total=total)
            results = play(
                chosen, policies, episodes, seed, goal, baseline, lambda n: progress.advance(task, n), executor=jobs
            )
    if as_json:
        brief = [{k: v for k, v in row.items() if k not in ("returns", "cases")} for row in results["policies"]]
        typer.echo(json.dumps({**results, "policies": brief}))
    else:
        _show(results)
    if output is not None:
        write_text(output, json.dumps(results, separators=(",", ":")) + "\n")
        if not as_json:
            out.print(f"wrote {plain(output)}")


def _show(results: dict[str, Any]) -> None:
    """What people see of an evaluation: the whole, then goal by goal."""
    from ..agents.evaluate.statistics import interval_text

    target, rows = results["target"], results["policies"]
    names = [row["policy"] for row in rows]
    what = f"{target['scenario']}, bench {target['bench']}" if target["bench"] else f"{target['scenario']}, laboratory"
    title = f"{what}: {results['episodes_per_goal']} episodes a goal; [{results['confidence']:.0%} intervals]"
    whole = []
    for row in rows:
        mean, middle, gain = (interval_text(row[key]) for key in ("mean", "interquartile_mean", "difference"))
        beside = ("", "") if row["policy"] == results["baseline"] else (gain, interval_text(row["improvement"], 2))
        whole.append((row["policy"], mean, middle, *beside, f"{row['mean_length']:.1f}"))
    head = ("policy", "mean", "interquartile mean", f"minus {results['baseline']}", "P(improvement)", "steps")
    show_table(title, head, whole, right=range(1, 6))
    for key, kind in (("by_goal", "goal"), ("by_case", "starting state")):
        if len(rows[0][key]) > 1:
            cells = [
                [case, *(interval_text(row[key][case].get("mean", row[key][case])) for row in rows)]
                for case in rows[0][key]
            ]
            show_table(f"mean return by {kind}", (kind, *names), cells, right=range(1, len(rows) + 1))
    if rows[0]["measures"]:
        cells = [[name, *(f"{row['measures'][name]:.3f}" for row in rows)] for name in rows[0]["measures"]]
        show_table("means of episodes", ("", *names), cells, right=range(1, len(rows) + 1))


@app.command()
def figures(
    results: Annotated[
        Path, typer.Argument(help="Folder with training runs, as `chemlab sweep` leaves it, or with tables of them.")
    ],
    output: Annotated[Path, typer.Option("--out", "-o", help="Where pages and figures go.")] = Path("figures"),
    collect: Annotated[
        Path | None,
        typer.Option(
            help="First make tables of the runs in this folder, and play the managers among them and what they are "
            "compared with; pages are made from the tables. What they have of other runs stays."
        ),
    ] = None,
    file_format: Annotated[
        list[str] | None, typer.Option("--format", help="png, svg or pdf; repeat the option. Default: png.")
    ] = None,
    trust: TrustOption = False,
) -> None:
    """Make pages of training runs: what each algorithm came to, with intervals, and learning curves.

    Managers of laboratories have a page of their own (laboratory.md), beside managers that learned nothing. Needs
    nothing but runs' small files or tables (and the extra `plot`); --collect also needs the runs' checkpoints.
    """
    with readable_errors():
        from ..agents.evaluate.laboratory import collect as collect_tables
        from ..agents.evaluate.laboratory import collect_count, write_laboratory
        from ..agents.evaluate.page import write_page
        from ..render.figure import FORMATS

        formats = file_format or ["png"]
        if unknown := [name for name in formats if name not in FORMATS]:
            raise ValueError(f"--format: known: {', '.join(FORMATS)}; given {', '.join(unknown)}")
        total = collect_count(results)
        left_out = []
        for folder in (output, *([collect] if collect is not None else [])):
            check_folder(folder)
        if collect is not None:
            with counting() as progress:
                task = progress.add_task("managers", total=total)
                left_out += collect_tables(results, collect, watch=lambda _: progress.advance(task))
        page, others = write_page(collect or results, output, formats)
        laboratory = write_laboratory(collect or results, output, formats)
        left_out += [*others, *(laboratory.left_out if laboratory is not None else ())]
    for line in left_out:
        out.print(f"[yellow]left out[/yellow] {plain(line)}")
    for written in (page, laboratory and laboratory.page):
        if written is not None:
            out.print(f"wrote {plain(written)}")
    if page is None and laboratory is None:
        out.print(f"{plain(results)}: has no training runs")
