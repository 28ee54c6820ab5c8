"""Command ``plot``: pages and figures of training runs and records."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from .options import ForceOption, TrustOption, app, check_result
from .screen import err, out, plain

plot = typer.Typer(help="Draw training runs and records (needs the extra `plot`).", no_args_is_help=True)
app.add_typer(plot, name="plot")

RecordArgument = Annotated[Path, typer.Argument(help="A record, finished or not (see `chemlab run --record`).")]
OutputOption = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="Output file, .png, .svg or .pdf (default: FILE-KIND.png beside the file)."),
]


def _save(path: Path, force: bool, draw: Callable[[], Any], *read: Path) -> None:
    """Draw a figure into a file, after a check of its format and of an existing file."""
    from ..render.figure import SETTINGS, check_format, import_matplotlib, save_figure

    check_format(path)
    check_result(path, force, *read)
    with import_matplotlib().rc_context(SETTINGS), err.status(plain(path)):
        save_figure(draw(), path)
    out.print(plain(path))


def _beside(record: Path, kind: str) -> Path:
    return record.parent / (f"{record.name.removesuffix('.part').rpartition('.')[0] or record.name}-{kind}.png")


@plot.command()
def curves(
    folders: Annotated[list[Path], typer.Argument(help="Training runs, or folders that contain training runs.")],
    output: Annotated[Path, typer.Option("--out", "-o", help="Output file, .png, .svg or .pdf.")] = Path("curves.png"),
    force: ForceOption = False,
) -> None:
    """Draw learning curves of training runs, finished or not, with evaluations and the scripted policy's score."""
    from ..agents.evaluate.curves import draw_curves

    _save(output, force, lambda: draw_curves(folders))


@plot.command()
def timeline(
    record: RecordArgument, output: OutputOption = None, force: ForceOption = False, trust: TrustOption = False
) -> None:
    """Draw a timeline: actions and experiments of every agent, cumulative costs and rewards."""
    from ..record import read_record
    from ..render.charts import draw_timeline

    _save(output or _beside(record, "timeline"), force, lambda: draw_timeline(read_record(record), trust), record)


@plot.command()
def spectra(
    record: RecordArgument, output: OutputOption = None, force: ForceOption = False, trust: TrustOption = False
) -> None:
    """Draw spectra of the vessel before and after each reaction experiment, with the materials' peaks."""
    from ..record import read_record
    from ..render.charts import draw_spectra

    _save(output or _beside(record, "spectra"), force, lambda: draw_spectra(read_record(record), trust), record)


@plot.command()
def moles(
    record: RecordArgument,
    only: Annotated[
        list[str] | None, typer.Option(help="Element or material to draw; repeatable. Default: all.")
    ] = None,
    output: OutputOption = None,
    force: ForceOption = False,
    trust: TrustOption = False,
) -> None:
    """Draw the mole balance from start to product, for each element that reacted and each other material."""
    from ..record import read_record
    from ..render.charts import draw_moles

    picture = output or _beside(record, "moles")
    _save(picture, force, lambda: draw_moles(read_record(record), trust, only or ()), record)


@plot.command()
def runs(
    results: Annotated[Path, typer.Argument(help="Folder that contains training runs.")],
    output: Annotated[Path, typer.Option("--out", "-o", help="Output folder of the page and figures.")] = Path(
        "figures"
    ),
    file_format: Annotated[
        list[str] | None, typer.Option("--format", help="png, svg or pdf; repeatable. Default: png.")
    ] = None,
) -> None:
    """Make a page of training runs: results of each algorithm with intervals, and learning curves.

    It needs only the runs' small files. To compare policies in the same episodes, use `chemlab evaluate`.
    """
    from ..agents.evaluate.page import write_page
    from ..render.figure import FORMATS

    formats = file_format or ["png"]
    if unknown := [name for name in formats if name not in FORMATS]:
        raise ValueError(f"--format: must be one of {', '.join(FORMATS)}; given {', '.join(unknown)}")
    page, left_out = write_page(results, output, formats)
    for line in left_out:
        out.print(f"[yellow]left out[/yellow] {plain(line)}")
    out.print(f"wrote {plain(page)}")
