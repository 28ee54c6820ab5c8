"""The commands export: a run's policy, demonstrations of records, starting states of a scenario."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from .options import (
    DefaultGroup,
    ForceOption,
    JsonOption,
    ScenarioArgument,
    SeedOption,
    TrustOption,
    app,
    check_result,
    prepare,
)
from .screen import counting, err, out, plain

export = typer.Typer(
    cls=DefaultGroup,
    help="Write the policy of a run (`chemlab export RUN`), demonstrations of records, or starting states of benches.",
    no_args_is_help=True,
)
app.add_typer(export, name="export")


@export.command()
def policy(
    run: Annotated[Path, typer.Argument(help="Folder of a training run; :greedy or :sampled after it.")],
    to: Annotated[Path, typer.Option("--out", "-o", help="Path of the two files; the file name is the policy's name.")],
    role: Annotated[str | None, typer.Option(help="Role to export, if several learned together.")] = None,
    force: ForceOption = False,
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Export a run's best checkpoint as a policy without PyTorch: NAME.safetensors and NAME.json.

    The policy plays greedily or sampled, as the checkpoint was evaluated, unless :greedy or :sampled follows the
    folder. The export fails if the policy's outputs on the bench's observations differ by more than 1e-5.
    """
    from ..agents.former_names import split_way
    from ..agents.train.export import export_run

    for ending in (".json", ".safetensors"):
        target = to.with_suffix(ending) if to.suffix in (".json", ".safetensors") else Path(f"{to}{ending}")
        check_result(target, force, *(file for file in Path(split_way(str(run))[0]).rglob("*") if file.is_file()))
    with err.status(plain(run)):
        card = export_run(run, to, role)
    if as_json:
        typer.echo(json.dumps(card.model_dump()))
        return
    found = card.evaluation
    out.print(plain(f"{card.name}: {card.label} of {card.env_id}, seed {card.seed}, step {card.step:,}"))
    scripted = found["scripted_mean"]
    way = ", sampled" if card.sampled else ""
    out.print(f"mean return {found['mean']:.3f}{way}, scripted {'none' if scripted is None else f'{scripted:.3f}'}")


@export.command()
def demos(
    files: Annotated[list[Path], typer.Argument(help="Records of one scenario (see `chemlab play --record`).")],
    name: Annotated[str, typer.Option("--name", "-o", help="Name of the datasets NAME/AGENT-v0.")],
    agent: Annotated[list[str] | None, typer.Option(help="An agent; repeatable. Default: all.")] = None,
    force: ForceOption = False,
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Export records as demonstrations: one Minari dataset per agent.

    The manager's episodes are those of the laboratory; an episode of a bench's agent is one experiment. Observations
    are recomputed by replay. Records that fail verification are rejected. Needs the extra `data`.
    """
    from ..agents.demonstrations import write_datasets

    with err.status(plain(name)):
        written = write_datasets(files, name, agent, force, trust, lambda note: err.print(plain(note)))
    rows = list(map(asdict, written))
    if as_json:
        typer.echo(json.dumps(rows))
        return
    for row in rows:
        counts = f"{row['episodes']} episodes, {row['steps']} steps, mean return {row['mean_return']:.3f}"
        out.print(plain(f"{row['id']}: {counts}, in {row['path']}"))
    out.print("load one with: minari.load_dataset(NAME)")


@export.command()
def starts(
    scenario: ScenarioArgument,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes for each goal.")] = 6,
    seed: SeedOption = 0,
    output: Annotated[
        Path | None, typer.Option("--out", "-o", help="Output file (default: the file that environments read).")
    ] = None,
    force: ForceOption = False,
    trust: TrustOption = False,
) -> None:
    """Record the vessels that reach each bench in laboratory episodes, for environments with starts='lab'."""
    with counting() as progress:
        spec, _ = prepare(scenario, quiet=True)
        from ..agents.start_recorder import record_starts
        from ..lab.starts import starts_file, write_starts

        path = output or starts_file(spec)
        if output is None and spec.shipped and path.exists():
            raise ValueError(
                f"{spec.name}: its recorded vessels are part of the package; give --out FILE to record others"
            )
        check_result(path, force or output is None, scenario)  # the default is renewed as often as asked
        task = progress.add_task("episodes", total=episodes * len(spec.goals))
        vessels = record_starts(spec, episodes, seed, lambda: progress.advance(task))
        write_starts(path, spec, vessels)
    counts = ", ".join(f"{len(found)} vessels for {bench}" for bench, found in vessels.items())
    out.print(f"{plain(path)}: {counts}")
