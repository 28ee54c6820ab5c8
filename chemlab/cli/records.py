"""Commands on records of episodes: verify, replay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..config.datafile import DataError
from .options import ForceOption, JsonOption, TrustOption, app, check_result
from .screen import counting, err, out, plain

if TYPE_CHECKING:
    from ..record import Status

_COLORS = {
    "ok": "green",
    "tampered": "red",
    "torn": "yellow",
    "other": "yellow",
    "foreign": "yellow",
    "chosen": "yellow",
    "unchecked": "red",
}


_RequiredOption = Annotated[
    str | None,
    typer.Option(
        help="The scenario that a record must be of: a bundled name or a path. "
        "Default: the bundled scenario of the same name."
    ),
]


@app.command()
def verify(
    files: Annotated[list[Path], typer.Argument(help="Records (see `chemlab run --record`), or a leaderboard.json.")],
    scenario: _RequiredOption = None,
    trust: TrustOption = False,
    split: Annotated[
        str | None,
        typer.Option(help="Required split of a record. private:SALT also proves that its world follows from its seed."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Verify records of episodes: replay their actions on the simulator and compare every number.

    For a leaderboard (a file with suffix .json), every entry is recomputed from the scores of its episodes, and its
    records are replayed.

    Exit codes: 0 if every record is right; 1 if a value differs from the replay (the first difference is named); 3 if
    the end is missing; 4 if another version or platform made the record; 5 if the file is not a record or cannot be
    replayed here; 6 if the record is right, but its scenario is neither bundled nor given, or its split is not the
    given one; 7 if the record is right, but its world was requested instead of drawn. For several records, the first
    of 1, 5, 4, 6, 7, 3 that occurs.
    """
    from ..record import EXIT_CODES, verify_record

    results: list[Status] = []
    for path in files:
        with err.status(plain(path)):
            result = verify_record(path, scenario, trust, split=split)
        if result.status == "unchecked" and path.suffix == ".json":
            try:
                results.append(_verify_leaderboard(path, as_json))
                continue
            except DataError as error:
                result.message += f"; nor a leaderboard: {error}"
        results.append(result.status)
        if as_json:
            typer.echo(json.dumps(vars(result)))
            continue
        color = _COLORS[result.status]
        out.print(f"[{color}]{result.status}[/{color}] {plain(result.path)}: {plain(result.message)}")
        for note in result.notes:
            out.print(f"   {plain(note)}")
    raise typer.Exit(next(code for status, code in EXIT_CODES.items() if status in results))


def _verify_leaderboard(path: Path, as_json: bool) -> Status:
    """Verify a leaderboard, print the faults, and return the status."""
    from ..agents.evaluate.leaderboard import check_leaderboard, summary

    with counting() as progress:
        task = progress.add_task("lines", total=None)
        checks = check_leaderboard(path, lambda _: progress.advance(task))
    status: Status = "tampered" if any(check.faults for check in checks) else "ok"
    if as_json:
        typer.echo(json.dumps({"path": str(path), "status": status, "lines": [vars(check) for check in checks]}))
        return status
    out.print(f"[{_COLORS[status]}]{status}[/{_COLORS[status]}] {plain(path)}: {plain(summary(checks))}")
    for check in checks:
        for fault in check.faults:
            out.print(f"   {plain(f'{check.scenario}, {check.policy}: {fault}')}")
    return status


@app.command()
def replay(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="A record, finished or not (see `chemlab run --record`). Two are shown side by side, in step.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Output file: a page (.html); for one record also an animation (.gif, .webp, with ffmpeg .mp4; needs "
            "the extra `plot`) or a protocol of its procedure (.md). Default: the record's name with .html.",
        ),
    ] = None,
    force: ForceOption = False,
    show: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    scenario: _RequiredOption = None,
    trust: TrustOption = False,
) -> None:
    """Make an interactive HTML page, an animation or a written protocol of a record; the page needs no network."""
    from ..config.files import write_bytes
    from ..config.loading import load_scenario
    from ..record import read_record

    path = output or files[0].with_name(f"{'-'.join(file.stem for file in files)}.html")
    animated, written = path.suffix in (".gif", ".webp", ".mp4"), path.suffix == ".md"
    if len(files) > (1 if animated or written else 2):
        raise ValueError(f"a page shows at most two records, an animation or a protocol one, given {len(files)}")
    check_result(path, force, *files)
    if not animated and not written and path.suffix not in (".html", ".htm"):
        raise ValueError(f"{path}: unknown suffix {path.suffix or 'none'}; choose from .html, .gif, .webp, .mp4, .md")
    required = None if scenario is None else load_scenario(scenario)
    records = [read_record(file) for file in files]
    for record in records:
        if record.torn:
            err.print(f"{plain(record.path)}: the end is missing; the available turns are shown")
    with err.status(plain(path)):
        if animated:
            from ..render.animation import animation

            content = animation(records[0], path.suffix[1:], trust, scenario=required)
        elif written:
            from ..render.protocol import protocol

            content = protocol(records[0], trust, required).encode()
        else:
            from ..render.replay_page import comparison_page, replay_page

            alone = len(records) == 1
            page = replay_page(records[0], trust, required) if alone else comparison_page(records, trust, required)
            content = page.encode()
    write_bytes(path, content)
    turns = " and ".join(str(len(record.turns)) for record in records)
    out.print(f"{plain(path)}: {turns} turns, {len(content) / 1e3:,.1f} kB")
    if show:
        typer.launch(path.resolve().as_uri())
